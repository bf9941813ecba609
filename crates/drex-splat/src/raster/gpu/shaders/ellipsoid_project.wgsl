// Projects ellipsoids. A footprint is centre, conic xx, xy | conic yy, opacity, depth, largest power | colour.

@group(0) @binding(2) var<storage, read_write> footprints: array<vec4f>;

@compute @workgroup_size(256)
fn project(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let i = line_index(id, groups);
    if i >= view.count {
        return;
    }
    let e = ellipsoid(i);
    let opacity = opacity_of(i) * e.compensation;
    let colour = colour_of(i, mean_of(i));
    if !e.drawn || opacity <= least_alpha() || largest(colour) > BRIGHTEST {
        footprints[3u * i + 1u] = vec4f(0.0);
        put_nothing(i);
        return;
    }
    let power = largest_power(opacity);
    let centre = view.focal * e.t.xy / e.t.z + view.principal;
    footprints[3u * i] = vec4f(centre, vec2f(e.cov.z, -e.cov.y) / e.det);
    footprints[3u * i + 1u] = vec4f(e.cov.x / e.det, opacity, e.t.z, power);
    footprints[3u * i + 2u] = vec4f(colour, 0.0);
    let half = sqrt(2.0 * power * e.cov.xz);
    put_box(i, centre - half, centre + half, e.t.z);
}

// Whether the smallest power over the tile's pixel centres is below the largest that counts.
fn touches(i: u32, tile: vec2u) -> bool {
    let f0 = footprints[3u * i];
    let f1 = footprints[3u * i + 1u];
    let q = vec3f(f0.zw, f1.x);
    let low = vec2f(tile * TILE) + 0.5 - f0.xy;
    let high = vec2f(min((tile + 1u) * TILE, view.size)) - 0.5 - f0.xy;
    // The smallest lies on the side nearest to the centre, or is the centre.
    let near = clamp(vec2f(0.0), low, high);
    let on_x = clamp(-q.y * near.x / q.z, low.y, high.y);
    let on_y = clamp(-q.y * near.y / q.x, low.x, high.x);
    let power = min(power_at(q, vec2f(near.x, on_x)), power_at(q, vec2f(on_y, near.y)));
    return power <= 1.0001 * f1.w + 1e-3;
}

fn power_at(q: vec3f, d: vec2f) -> f32 {
    return 0.5 * (q.x * d.x * d.x + q.z * d.y * d.y) + q.y * d.x * d.y;
}
