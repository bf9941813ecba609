// Projects surfels. A footprint is Tu, origin x | Tv, origin y | Tw, opacity | colour, depth | normal, largest power |
// centre of the floor | axis and range of the strip.

@group(0) @binding(2) var<storage, read_write> footprints: array<vec4f>;

@compute @workgroup_size(256)
fn project(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let i = line_index(id, groups);
    if i >= view.count {
        return;
    }
    let e = surfel(i);
    let opacity = opacity_of(i);
    let colour = colour_of(i, mean_of(i));
    if !e.drawn || opacity <= least_alpha() || largest(colour) > BRIGHTEST {
        footprints[7u * i + 4u] = vec4f(0.0);
        put_nothing(i);
        return;
    }
    let power = largest_power(opacity);
    footprints[7u * i] = vec4f(e.tu, e.origin.x);
    footprints[7u * i + 1u] = vec4f(e.tv, e.origin.y);
    footprints[7u * i + 2u] = vec4f(e.tw, opacity);
    footprints[7u * i + 3u] = vec4f(colour, e.t.z);
    footprints[7u * i + 4u] = vec4f(e.flip * e.r[2], power);
    footprints[7u * i + 5u] = vec4f(e.centre, 0.0, 0.0);
    let reach = reach_of(e, power);
    footprints[7u * i + 6u] = vec4f(reach.axis, reach.strip);
    put_box(i, e.origin + reach.low, e.origin + reach.high, e.t.z);
}

// Whether the strip meets the tile; the box does.
fn touches(i: u32, tile: vec2u) -> bool {
    let axis = footprints[7u * i + 6u].xy;
    let strip = footprints[7u * i + 6u].zw;
    let origin = vec2f(footprints[7u * i].w, footprints[7u * i + 1u].w);
    let middle = dot(axis, vec2f(tile * TILE) + 0.5 * f32(TILE) - origin);
    let half = 0.5 * f32(TILE - 1u) * (abs(axis.x) + abs(axis.y));
    return middle + half >= strip.x && middle - half <= strip.y;
}
