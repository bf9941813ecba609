// Projects surfels. A footprint is Tu, origin x | Tv, origin y | Tw, opacity | colour, depth | normal, largest power |
// centre of the floor.

@group(0) @binding(2) var<storage, read_write> footprints: array<vec4f>;

// A disc that all but touches the camera's plane has a box too large for these digits: the whole image.
const TOUCHES_PLANE = -1e-4;

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
        footprints[6u * i + 4u] = vec4f(0.0);
        put_nothing(i);
        return;
    }
    let power = largest_power(opacity);
    footprints[6u * i] = vec4f(e.tu, e.origin.x);
    footprints[6u * i + 1u] = vec4f(e.tv, e.origin.y);
    footprints[6u * i + 2u] = vec4f(e.tw, opacity);
    footprints[6u * i + 3u] = vec4f(colour, e.t.z);
    footprints[6u * i + 4u] = vec4f(e.flip * e.r[2], power);
    footprints[6u * i + 5u] = vec4f(e.centre, 0.0, 0.0);
    var low = vec2f(0.0);
    var high = vec2f(view.size);
    let w = box_weights(e.tw, 2.0 * power);
    if w.w < TOUCHES_PLANE {
        let middle = vec2f(dot(w.xyz, e.tu * e.tw), dot(w.xyz, e.tv * e.tw));
        let square = middle * middle - vec2f(dot(w.xyz, e.tu * e.tu), dot(w.xyz, e.tv * e.tv));
        let half = sqrt(max(square, vec2f(0.0)) + 1e-5 * (middle * middle + 1.0));
        let spot = sqrt(power);
        let floor_at = select(middle, e.centre, e.centre < vec2f(NOWHERE));
        low = e.origin + min(middle - half, floor_at - spot);
        high = e.origin + max(middle + half, floor_at + spot);
    }
    put_box(i, low, high, e.t.z);
}

fn touches(i: u32, tile: vec2u) -> bool {
    return footprints[6u * i + 4u].w > 0.0;
}
