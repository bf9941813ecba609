// Draws ellipsoids, front to back, and goes back over them.

const RECORD = 12u;

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
    var count = 0u;
    var end = 0u;
    for (var s = range.x; s < range.y; s++) {
        let i = 3u * splats[s];
        let f0 = footprints[i];
        let f1 = footprints[i + 1u];
        let d = f0.xy - at;
        let power = 0.5 * (f0.z * d.x * d.x + f1.x * d.y * d.y) + f0.w * d.x * d.y;
        let alpha = opacity(f1.y * exp(-power)).x;
        if alpha == 0.0 {
            continue;
        }
        let next = transmittance * (1.0 - alpha);
        if next <= MIN_TRANSMITTANCE {
            break;
        }
        let w = transmittance * alpha;
        colour += w * footprints[i + 2u].rgb;
        depth += w * f1.z;
        transmittance = next;
        count++;
        end = s + 1u - range.x;
    }
    let i = id.y * view.size.x + id.x;
    put3(0u, i, colour + transmittance * view.background.rgb);
    put1(3u, i, 1.0 - transmittance);
    put1(4u, i, depth);
    put1(10u, i, f32(count));
    marks[i] = vec4f(transmittance, 0.0, 0.0, 0.0);
    ends[i] = vec2u(end, 0u);
}

var<workgroup> by_depth: array<f32, 256>;

@compute @workgroup_size(64)
fn draw_back(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_index) local: u32) {
    for (var p = local; p < PIXELS; p += WALKERS) {
        let pixel = tile.xy * TILE + vec2u(p % TILE, p / TILE);
        load_pixel(p, pixel);
        if inside(pixel) {
            by_depth[p] = by1(4u, pixel.y * view.size.x + pixel.x);
        }
    }
    workgroupBarrier();
    let length = workgroupUniformLoad(&longest);
    let first = ranges[tile.y * view.tiles.x + tile.x].x;
    for (var done = 0u; done < length; done += WALKERS) {
        let mine = done + local < length;
        let place = length - 1u - min(done + local, length - 1u);
        let i = 3u * splats[first + place];
        let f0 = footprints[i];
        let f1 = footprints[i + 1u];
        let colour = footprints[i + 2u].rgb;
        var by_centre = vec2f(0.0);
        var by_abs_centre = vec2f(0.0);
        var by_conic = vec3f(0.0);
        var by_opacity = 0.0;
        var by_rgb = vec3f(0.0);
        var by_z = 0.0;
        for (var step = 0u; step < PIXELS + WALKERS - 1u; step++) {
            let p = step - local;
            if mine && p < PIXELS && place < end_of[p] {
                let at = vec2f(tile.xy * TILE + vec2u(p % TILE, p / TILE)) + 0.5;
                let d = f0.xy - at;
                let power = 0.5 * (f0.z * d.x * d.x + f1.x * d.y * d.y) + f0.w * d.x * d.y;
                let o = opacity(f1.y * exp(-power));
                let alpha = o.x;
                if alpha > 0.0 {
                    let b = behind[p];
                    let transmittance = b.x / (1.0 - alpha);
                    let w = transmittance * alpha;
                    let by = by_colour[p];
                    let by_w = dot(by.rgb, colour) + by.a + by_depth[p] * f1.z;
                    behind[p] = vec2f(transmittance, b.y + w * by_w);
                    by_rgb += w * by.rgb;
                    by_z += w * by_depth[p];
                    let by_power = -o.y * (transmittance * by_w - b.y / (1.0 - alpha));
                    let g = by_power * vec2f(f0.z * d.x + f0.w * d.y, f0.w * d.x + f1.x * d.y);
                    by_centre += g;
                    by_abs_centre += abs(g);
                    by_conic += by_power * vec3f(0.5 * d.x * d.x, d.x * d.y, 0.5 * d.y * d.y);
                    by_opacity -= by_power / f1.y;
                }
            }
            workgroupBarrier();
        }
        if mine {
            let r = RECORD * pair_ids[first + place];
            records[r] = by_centre.x;
            records[r + 1u] = by_centre.y;
            records[r + 2u] = by_abs_centre.x;
            records[r + 3u] = by_abs_centre.y;
            records[r + 4u] = by_conic.x;
            records[r + 5u] = by_conic.y;
            records[r + 6u] = by_conic.z;
            records[r + 7u] = by_opacity;
            records[r + 8u] = by_rgb.x;
            records[r + 9u] = by_rgb.y;
            records[r + 10u] = by_rgb.z;
            records[r + 11u] = by_z;
        }
    }
}
