// Draws surfels, front to back, and goes back over them.

const RECORD = 21u;

// Where the ray through a pixel meets a surfel (2DGS, eq. 8 to 10).
struct Meeting {
    seen: bool,
    k: vec3f,
    l: vec3f,
    p_z: f32,
    uv: vec2f,
    z: f32,
    // From the pixel to the floor's centre, and whether the floor is nearer, in standard deviations, than the disc.
    to_centre: vec2f,
    on_floor: bool,
    // Opacity, and its derivative by its logarithm before it is limited.
    alpha: f32,
    slope: f32,
}

// Rays with a larger u or v miss; so do those that meet the plane farther away than this many times the depth of the
// surfel's centre, which sees it edge-on.
const FARTHEST_UV = 1e9;
const FARTHEST_DEPTH = 1e6;

// `d` is the pixel's centre from the surfel's origin.
fn meet(i: u32, d: vec2f) -> Meeting {
    var m: Meeting;
    let tu = footprints[i].xyz;
    let tv = footprints[i + 1u].xyz;
    let tw = footprints[i + 2u];
    m.k = d.x * tw.xyz - tu;
    m.l = d.y * tw.xyz - tv;
    let p = cross(m.k, m.l);
    if !(abs(p.z) * FARTHEST_UV > max(abs(p.x), abs(p.y))) {
        return m;
    }
    m.p_z = p.z;
    m.uv = p.xy / p.z;
    m.z = dot(tw.xy, m.uv) + tw.z;
    m.to_centre = footprints[i + 5u].xy - d;
    let disc = dot(m.uv, m.uv);
    let spot = 2.0 * dot(m.to_centre, m.to_centre);
    m.on_floor = spot < disc;
    let o = opacity(tw.w * exp(-0.5 * min(disc, spot)));
    m.alpha = o.x;
    m.slope = o.y;
    m.seen = o.x > 0.0 && m.z > view.near && m.z < FARTHEST_DEPTH * footprints[i + 3u].w;
    return m;
}

fn origin_of(i: u32) -> vec2f {
    return vec2f(footprints[i].w, footprints[i + 1u].w);
}

// m of the distortion is this times (1 / z of the pixel's first splat - 1 / z): only differences of m count, and these
// keep their digits.
fn distortion_scale() -> f32 {
    return view.range.x * view.range.y / (view.range.y - view.range.x);
}

@compute @workgroup_size(16, 16)
fn draw(@builtin(workgroup_id) tile: vec3u, @builtin(global_invocation_id) id: vec3u) {
    if !inside(id.xy) {
        return;
    }
    let at = vec2f(id.xy) + 0.5;
    let range = ranges[tile.y * view.tiles.x + tile.x];
    var transmittance = 1.0;
    var colour = vec3f(0.0);
    var depth = 0.0;
    var normal = vec3f(0.0);
    var median = 0.0;
    var median_end = 0u;
    var distortion = 0.0;
    var first = 0.0;
    var m1 = 0.0;
    var m2 = 0.0;
    var count = 0u;
    var end = 0u;
    for (var s = range.x; s < range.y; s++) {
        let i = 7u * splats[s];
        let hit = meet(i, at - origin_of(i));
        if !hit.seen {
            continue;
        }
        let alpha = hit.alpha;
        let next = transmittance * (1.0 - alpha);
        if next <= MIN_TRANSMITTANCE {
            break;
        }
        let w = transmittance * alpha;
        let f3 = footprints[i + 3u];
        end = s + 1u - range.x;
        count++;
        colour += w * f3.rgb;
        depth += w * select(f3.a, hit.z, has(RAY_DEPTH));
        if has(GEOMETRY) {
            normal += w * footprints[i + 4u].xyz;
            if transmittance > 0.5 {
                median = hit.z;
                median_end = end;
            }
            if count == 1u {
                first = 1.0 / hit.z;
            }
            let m = distortion_scale() * (first - 1.0 / hit.z);
            distortion += w * (m * m * (1.0 - transmittance) + m2 - 2.0 * m * m1);
            m1 += w * m;
            m2 += w * m * m;
        }
        transmittance = next;
    }
    let i = id.y * view.size.x + id.x;
    put3(0u, i, colour + transmittance * view.background.rgb);
    put1(3u, i, 1.0 - transmittance);
    put1(4u, i, depth);
    put3(5u, i, normal);
    put1(8u, i, median);
    put1(9u, i, distortion);
    put1(10u, i, f32(count));
    marks[i] = vec4f(transmittance, first, m1, m2);
    ends[i] = vec2u(end, median_end);
}

// Derivative by the normal, and by the depth.
var<workgroup> by_normal: array<vec4f, 256>;

@compute @workgroup_size(64)
fn draw_back(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_index) local: u32) {
    for (var p = local; p < PIXELS; p += WALKERS) {
        let pixel = tile.xy * TILE + vec2u(p % TILE, p / TILE);
        load_pixel(p, pixel);
        if inside(pixel) {
            let at = pixel.y * view.size.x + pixel.x;
            by_normal[p] = vec4f(by3(5u, at), by1(4u, at));
        }
    }
    workgroupBarrier();
    let length = workgroupUniformLoad(&longest);
    let first = ranges[tile.y * view.tiles.x + tile.x].x;
    for (var done = 0u; done < length; done += WALKERS) {
        let mine = done + local < length;
        let place = length - 1u - min(done + local, length - 1u);
        let i = 7u * splats[first + place];
        let origin = origin_of(i);
        let tw = footprints[i + 2u];
        let f3 = footprints[i + 3u];
        let normal = footprints[i + 4u].xyz;
        var by_tu = vec3f(0.0);
        var by_tv = vec3f(0.0);
        var by_tw = vec3f(0.0);
        var by_floor = vec2f(0.0);
        var by_abs_centre = vec2f(0.0);
        var by_opacity = 0.0;
        var by_rgb = vec3f(0.0);
        var by_n = vec3f(0.0);
        var by_centre_z = 0.0;
        for (var step = 0u; step < PIXELS + WALKERS - 1u; step++) {
            let p = step - local;
            if mine && p < PIXELS && place < end_of[p] {
                let pixel = tile.xy * TILE + vec2u(p % TILE, p / TILE);
                let d = vec2f(pixel) + 0.5 - origin;
                let hit = meet(i, d);
                if hit.seen {
                    let alpha = hit.alpha;
                    let b = behind[p];
                    let transmittance = b.x / (1.0 - alpha);
                    let w = transmittance * alpha;
                    let by = by_colour[p];
                    let by_nz = by_normal[p];
                    var by_w = dot(by.rgb, f3.rgb) + by.a + by_nz.w * select(f3.a, hit.z, has(RAY_DEPTH));
                    var by_z = 0.0;
                    if has(RAY_DEPTH) {
                        by_z = w * by_nz.w;
                    } else {
                        by_centre_z += w * by_nz.w;
                    }
                    if has(GEOMETRY) {
                        let at = pixel.y * view.size.x + pixel.x;
                        by_w += dot(by_nz.xyz, normal);
                        by_n += w * by_nz.xyz;
                        by_z += select(0.0, by1(8u, at), kept_ends[at].y == place + 1u);
                        // Σ_{i<j} w_i w_j (m_i - m_j)² = A M₂ - M₁².
                        let by_distortion = by1(9u, at);
                        let kept = kept_marks[at];
                        let m = distortion_scale() * (kept.y - 1.0 / hit.z);
                        by_w += by_distortion * (m * m * (1.0 - kept.x) + kept.w - 2.0 * m * kept.z);
                        by_z += by_distortion * 2.0 * w * (m * (1.0 - kept.x) - kept.z)
                            * distortion_scale() / (hit.z * hit.z);
                    }
                    behind[p] = vec2f(transmittance, b.y + w * by_w);
                    by_rgb += w * by.rgb;
                    var by_uv = by_z * tw.xy;
                    by_tw += by_z * vec3f(hit.uv, 1.0);
                    let by_power = -hit.slope * (transmittance * by_w - b.y / (1.0 - alpha));
                    by_opacity -= by_power / tw.w;
                    var by_to_centre = vec2f(0.0);
                    if hit.on_floor {
                        by_to_centre = 2.0 * by_power * hit.to_centre;
                    } else {
                        by_uv += by_power * hit.uv;
                    }
                    let by_p = vec3f(by_uv, -dot(hit.uv, by_uv)) / hit.p_z;
                    let by_k = cross(hit.l, by_p);
                    let by_l = cross(by_p, hit.k);
                    by_tu -= by_k;
                    by_tv -= by_l;
                    by_tw += d.x * by_k + d.y * by_l;
                    by_floor += by_to_centre;
                    by_abs_centre += abs(by_to_centre - vec2f(dot(by_k, tw.xyz), dot(by_l, tw.xyz)));
                }
            }
            workgroupBarrier();
        }
        if mine {
            let r = RECORD * pair_ids[first + place];
            put_record3(r, by_tu);
            put_record3(r + 3u, by_tv);
            put_record3(r + 6u, by_tw);
            put_record3(r + 9u, by_rgb);
            put_record3(r + 12u, by_n);
            records[r + 15u] = by_floor.x;
            records[r + 16u] = by_floor.y;
            records[r + 17u] = by_abs_centre.x;
            records[r + 18u] = by_abs_centre.y;
            records[r + 19u] = by_opacity;
            records[r + 20u] = by_centre_z;
        }
    }
}

fn put_record3(at: u32, value: vec3f) {
    records[at] = value.x;
    records[at + 1u] = value.y;
    records[at + 2u] = value.z;
}
