// What patchmatch.rs does to a pixel, and kernel.rs to a window, in their words: one thread a pixel of one colour.
// Constants that have no value here are written by gpu.rs before this text: RADIUS is that of the window. A plane is (w, a, b).

const SIDE = RADIUS + 1;
const SAMPLES = SIDE * SIDE;
const TAU = 6.2831853;
/// Of a word of `greys`; INSIDE is the mark beside it.
const LEVEL = 255u;

struct Scale {
    size: vec2u,
    /// Of its pixels in `greys`.
    first: u32,
    least_variance: f32,
}

struct View {
    size: vec2u,
    seed: vec2u,
    focal: vec2f,
    centre: vec2f,
    scales: array<Scale, 2>,
    noise_variance: vec2f,
    disparity: f32,
    scale_count: u32,
    sources: u32,
    peers: u32,
    masked: u32,
    // The pass.
    colour: u32,
    number: u32,
    far: u32,
    restart: u32,
    last: u32,
    step_px: f32,
}

/// Another photo: how pixels get there, and where its quads or planes begin.
struct Other {
    turn: mat3x3f,
    shift: vec3f,
    weight: f32,
    limit: vec2f,
    first: u32,
    stride: u32,
}

@group(0) @binding(0) var<uniform> view: View;
/// Weights of the samples by distance, then of differences of grey.
@group(0) @binding(1) var<storage> window: array<f32>;
@group(0) @binding(2) var<storage> greys: array<u32>;
@group(0) @binding(3) var<storage> limits_of: array<vec2f>;
/// The sources at the first scale, at the second, and the peers.
@group(0) @binding(4) var<storage> others: array<Other>;
@group(0) @binding(5) var<storage> quads: array<u32>;
/// Planes of the peers and their costs.
@group(0) @binding(6) var<storage> peers: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> field: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> deviations: array<f32>;

// The window, in the largest picture in which it shows something.
var<private> weight: array<f32, SAMPLES>;
var<private> centred: array<f32, SAMPLES>;
var<private> variance: f32;
var<private> scale: u32;
var<private> seen_at: vec2f;
var<private> aside: vec2f;
// The trial.
var<private> at: vec2f;
var<private> limits: vec2f;
var<private> order: array<u32, MOST_SOURCES>;
var<private> best: vec3f;
var<private> best_cost: f32;
var<private> random: vec2u;

fn moved(plane: vec3f, step: vec2f) -> vec3f {
    return vec3f(plane.x + dot(plane.yz, step), plane.yz);
}

fn patch_at(centre: vec2i) {
    let picture = view.scales[scale];
    let size = vec2i(picture.size);
    let own = i32(greys[picture.first + u32(centre.y * size.x + centre.x)] & LEVEL);
    var sum = 0.0;
    var mean = 0.0;
    for (var k = 0; k < SAMPLES; k++) {
        weight[k] = 0.0;
        centred[k] = 0.0;
        let p = centre + 2 * vec2i(k % SIDE, k / SIDE) - RADIUS;
        if any(p < vec2i(0)) || any(p >= size) {
            continue;
        }
        let word = greys[picture.first + u32(p.y * size.x + p.x)];
        if view.masked != 0u && (word & INSIDE) == 0u {
            continue;
        }
        let grey = i32(word & LEVEL);
        weight[k] = window[k] * window[SAMPLES + abs(grey - own)];
        centred[k] = f32(grey);
        sum += weight[k];
        mean += weight[k] * f32(grey);
    }
    variance = 0.0;
    if sum <= 0.0 {
        return;
    }
    mean /= sum;
    for (var k = 0; k < SAMPLES; k++) {
        weight[k] /= sum;
        let deviation = centred[k] - mean;
        centred[k] = weight[k] * deviation;
        variance += centred[k] * deviation;
    }
}

fn see(place: vec2u) {
    for (scale = 0u; ; scale++) {
        let pixel = min(place >> vec2u(scale), view.scales[scale].size - 1u);
        patch_at(vec2i(pixel));
        if variance >= view.scales[scale].least_variance || scale + 1u == view.scale_count {
            seen_at = vec2f(pixel);
            aside = (seen_at + 0.5) * f32(1u << scale) - 0.5 - vec2f(place);
            return;
        }
    }
}

/// A place of the reference with an inverse depth in another photo, homogeneous.
fn mapped(other: u32, place: vec2f, w: f32) -> vec3f {
    return others[other].turn * vec3f(place, 1.0) + others[other].shift * w;
}

fn photometric(plane: vec3f, source: u32) -> f32 {
    let i = scale * view.sources + source;
    let shift = others[i].shift;
    let slopes = f32(1u << scale) * plane.yz;
    let origin = mapped(i, seen_at, moved(plane, aside).x);
    let right = others[i].turn[0] + shift * slopes.x;
    let down = others[i].turn[1] + shift * slopes.y;
    let r = f32(RADIUS);
    for (var k = 0u; k < 4u; k++) {
        let p = origin + select(-r, r, (k & 1u) != 0u) * right + select(-r, r, (k & 2u) != 0u) * down;
        if !(p.z > 0.0 && p.x >= 0.0 && p.y >= 0.0 && all(p.xy < others[i].limit * p.z)) {
            return WORST;
        }
    }
    let first = others[i].first;
    let stride = others[i].stride;
    var sum = 0.0;
    var squares = 0.0;
    var product = 0.0;
    for (var k = 0; k < SAMPLES; k++) {
        let step = vec2f(2 * vec2i(k % SIDE, k / SIDE) - RADIUS);
        let p = origin + step.x * right + step.y * down;
        let place = p.xy / p.z;
        let whole = floor(place);
        let part = place - whole;
        let quad = vec4f(unpack4xU8(quads[first + u32(whole.y) * stride + u32(whole.x)]));
        let rows = mix(quad.xz, quad.yw, part.x);
        let grey = mix(rows.x, rows.y, part.y);
        sum += weight[k] * grey;
        squares += weight[k] * grey * grey;
        product += centred[k] * grey;
    }
    let there = squares - sum * sum;
    if !(there >= LEAST_VARIANCE) {
        return WORST;
    }
    return clamp(1.0 - product / sqrt(variance * there), 0.0, WORST);
}

fn disagreement_px(w: f32, source: u32) -> f32 {
    let there = mapped(source, at, w);
    let place = there.xy / there.z;
    let nearest = floor(place + 0.5);
    let peer = view.scale_count * view.sources + source;
    if !(there.z > 0.0 && all(nearest >= vec2f(0.0)) && all(nearest < others[peer].limit)) {
        return MOST_PX;
    }
    let found = peers[others[peer].first + u32(nearest.y) * others[peer].stride + u32(nearest.x)];
    let back = mapped(peer, place, moved(found.xyz, place - nearest).x);
    if !(found.w < NEVER && back.z > 0.0) {
        return MOST_PX;
    }
    return min(distance(back.xy / back.z, at), MOST_PX);
}

fn cost(plane: vec3f, source: u32) -> f32 {
    var sum = photometric(plane, source);
    if source < view.peers {
        if sum < WORST {
            sum += PER_PIXEL * disagreement_px(plane.x, source);
        } else {
            sum += PER_PIXEL * MOST_PX;
        }
    }
    return sum;
}

fn counted(costs: ptr<function, array<f32, MOST_SOURCES>>) -> f32 {
    var used = 0u;
    var sum = 0.0;
    var weights = 0.0;
    for (var i = 0u; i < min(COUNTED, view.sources); i++) {
        var least = MOST_SOURCES;
        for (var k = 0u; k < view.sources; k++) {
            if (used >> k & 1u) == 0u && (least == MOST_SOURCES || (*costs)[k] < (*costs)[least]) {
                least = k;
            }
        }
        used |= 1u << least;
        sum += others[least].weight * (*costs)[least];
        weights += others[least].weight;
    }
    if weights > 0.0 {
        return sum / weights;
    }
    return WORST;
}

fn begin(place: vec2u, pixel: u32) {
    at = vec2f(place);
    limits = limits_of[pixel];
    best = field[pixel].xyz;
    var costs: array<f32, MOST_SOURCES>;
    for (var k = 0u; k < view.sources; k++) {
        costs[k] = cost(best, k);
        var i = k;
        for (; i > 0u && costs[k] < costs[order[i - 1u]]; i--) {
            order[i] = order[i - 1u];
        }
        order[i] = k;
    }
    best_cost = counted(&costs);
}

fn ray() -> vec3f {
    return vec3f((at - view.centre) / view.focal, 1.0);
}

fn possible(plane: vec3f) -> bool {
    let ray = ray();
    let slopes = plane.yz * view.focal;
    let m = vec3f(slopes, plane.x - dot(slopes, ray.xy));
    return plane.x >= limits.x && plane.x <= limits.y
        && plane.x * plane.x >= LEAST_COSINE * LEAST_COSINE * dot(m, m) * dot(ray, ray);
}

fn cost_of(plane: vec3f) -> f32 {
    if !possible(plane) {
        return NEVER;
    }
    var costs: array<f32, MOST_SOURCES>;
    for (var done = 0u; done < view.sources; done++) {
        if done == 2u && 0.5 * (costs[order[0]] + costs[order[1]]) > best_cost + EARLY_STOP_COST {
            return NEVER;
        }
        costs[order[done]] = cost(plane, order[done]);
    }
    return counted(&costs);
}

fn offer(plane: vec3f) {
    let new_cost = cost_of(plane);
    if new_cost < best_cost {
        best = plane;
        best_cost = new_cost;
    }
}

fn descend(step: vec3f) {
    let middle = best;
    let before = min(cost_of(middle - step), 2.0 * WORST);
    let after = min(cost_of(middle + step), 2.0 * WORST);
    let curvature = before - 2.0 * best_cost + after;
    if before < best_cost || after < best_cost {
        best = middle + select(step, -step, before < after);
        best_cost = min(before, after);
    } else if curvature > 1e-6 {
        offer(middle + 0.5 * (before - after) / curvature * step);
    }
}

/// Low and high word of a product of two words.
fn product(a: u32, b: u32) -> vec2u {
    let low = (a & 0xffffu) * (b & 0xffffu);
    let across = vec2u((a & 0xffffu) * (b >> 16u), (a >> 16u) * (b & 0xffffu));
    let middle = (low >> 16u) + (across.x & 0xffffu) + (across.y & 0xffffu);
    let high = (a >> 16u) * (b >> 16u) + (across.x >> 16u) + (across.y >> 16u) + (middle >> 16u);
    return vec2u(low & 0xffffu | middle << 16u, high);
}

fn times(a: vec2u, b: vec2u) -> vec2u {
    return product(a.x, b.x) + vec2u(0u, a.x * b.y + a.y * b.x);
}

/// a ^ (a >> bits), for less than 32 bits.
fn folded(a: vec2u, bits: u32) -> vec2u {
    return a ^ vec2u(a.x >> bits | a.y << (32u - bits), a.y >> bits);
}

/// SplitMix64, in words, the low one first.
fn next() -> vec2u {
    const STEP = vec2u(0x7f4a7c15u, 0x9e3779b9u);
    let low = random.x + STEP.x;
    random = vec2u(low, random.y + STEP.y + select(0u, 1u, low < STEP.x));
    let z = times(folded(random, 30u), vec2u(0x1ce4e5b9u, 0xbf58476du));
    return folded(times(folded(z, 27u), vec2u(0x133111ebu, 0x94d049bbu)), 31u);
}

fn unit() -> f32 {
    return f32(next().y >> 8u) / 16777216.0;
}

fn signed() -> f32 {
    return 2.0 * unit() - 1.0;
}

fn any_plane() -> vec3f {
    let w = limits.x + (limits.y - limits.x) * unit();
    let ray = ray();
    var normal = vec3f(0.0);
    var facing = -1.0;
    for (var k = 0; k < 2; k++) {
        let z = signed();
        let angle = TAU * unit();
        let n = vec3f(sqrt(max(1.0 - z * z, 0.0)) * vec2f(cos(angle), sin(angle)), z);
        let cosine = -dot(n, ray) / length(ray);
        if abs(cosine) > facing {
            normal = select(n, -n, cosine < 0.0);
            facing = abs(cosine);
        }
    }
    if facing < 0.3 {
        normal = -normalize(ray);
    }
    let m = normal * (w / dot(normal, ray));
    return vec3f(w, m.xy / view.focal);
}

/// The step to candidate `k` of an area: a V upwards, downwards, to the left or to the right, or a line further there.
fn candidate(area: u32, k: i32) -> vec2i {
    var ahead = 3 + 2 * k;
    var beside = 0;
    if area < 4u {
        ahead = 1 + (k + 1) / 2;
        beside = select(ahead - 1, 1 - ahead, k % 2 == 1);
    }
    switch area % 4u {
        case 0u: { return vec2i(beside, -ahead); }
        case 1u: { return vec2i(beside, ahead); }
        case 2u: { return vec2i(-ahead, beside); }
        default: { return vec2i(ahead, beside); }
    }
}

fn offer_neighbours(place: vec2i) {
    let near = TWIN_PX / view.disparity;
    var tried: array<vec3f, 9>;
    tried[0] = best;
    var count = 1;
    for (var area = 0u; area < select(4u, 8u, view.far != 0u); area++) {
        var nearby = vec2i(0);
        var least = NEVER;
        for (var k = 0; k < select(11, 7, area < 4u); k++) {
            let step = candidate(area, k);
            let p = place + step;
            if all(p >= vec2i(0)) && all(p < vec2i(view.size)) {
                let cost = field[u32(p.y) * view.size.x + u32(p.x)].w;
                if cost < least {
                    nearby = step;
                    least = cost;
                }
            }
        }
        if least == NEVER {
            continue;
        }
        let p = vec2u(place + nearby);
        let plane = moved(field[p.y * view.size.x + p.x].xyz, -vec2f(nearby));
        var known = false;
        for (var k = 0; k < count; k++) {
            known = known || all(abs(tried[k] - plane) * vec3f(1.0, vec2f(f32(RADIUS))) < vec3f(near));
        }
        if !known {
            tried[count] = plane;
            count++;
            offer(plane);
        }
    }
}

@compute @workgroup_size(WORKGROUP, WORKGROUP)
fn improve(@builtin(global_invocation_id) id: vec3u) {
    let place = vec2u(2u * id.x + (id.y + view.colour) % 2u, id.y);
    let pixel = place.y * view.size.x + place.x;
    if any(place >= view.size) || (greys[pixel] & INSIDE) == 0u {
        return;
    }
    see(place);
    if variance < LEAST_VARIANCE {
        field[pixel].w = WORST;
        return;
    }
    begin(place, pixel);
    offer_neighbours(vec2i(place));
    random = view.seed;
    random = next() ^ vec2u(view.number, 0u);
    random = next() ^ vec2u(pixel, 0u);
    if view.restart != 0u {
        offer(any_plane());
    }
    if view.step_px > 0.0 {
        let along = view.step_px / view.disparity;
        let across = along / f32(RADIUS);
        offer(best + vec3f(along * signed(), 0.0, 0.0));
        let a = across * signed();
        offer(best + vec3f(0.0, a, across * signed()));
        let w = 0.5 * along * signed();
        let slope = 0.5 * across * signed();
        offer(best + vec3f(w, slope, 0.5 * across * signed()));
    }
    if view.last != 0u {
        for (var px = 0.3; px > 0.1; px *= 0.5) {
            let along = px / view.disparity;
            let across = along / f32(RADIUS);
            descend(vec3f(along, 0.0, 0.0));
            descend(vec3f(0.0, across, 0.0));
            descend(vec3f(0.0, 0.0, across));
        }
    }
    field[pixel] = vec4f(best, best_cost);
}

fn mean_photometric(w: f32) -> f32 {
    let n = min(COUNTED, view.sources);
    var sum = 0.0;
    for (var k = 0u; k < n; k++) {
        sum += photometric(vec3f(w, best.yz), order[k]);
    }
    return sum / f32(n);
}

@compute @workgroup_size(WORKGROUP, WORKGROUP)
fn deviate(@builtin(global_invocation_id) id: vec3u) {
    let pixel = id.y * view.size.x + id.x;
    if any(id.xy >= view.size) {
        return;
    }
    deviations[pixel] = NEVER;
    if !(field[pixel].w < WORST) {
        return;
    }
    see(id.xy);
    if variance < LEAST_VARIANCE {
        return;
    }
    begin(id.xy, pixel);
    let size = f32(1u << scale);
    let step = size / view.disparity;
    let rise = min(mean_photometric(best.x - step), mean_photometric(best.x + step)) - mean_photometric(best.x);
    if rise > 0.0 {
        let noise = view.noise_variance[scale] / (2.0 * variance);
        deviations[pixel] = size * sqrt((max(best_cost, LEAST_COST) + noise) / (INDEPENDENT * rise));
    }
}
