// The lists of splats of every tile: nearest first, ties by index. Follows a file with `touches`.

// Of every Gaussian: its tiles (first column | end of columns << 16, the same of rows), how many it touches, its depth
// as an integer that sorts as the depth does.
@group(0) @binding(3) var<storage, read_write> boxes: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> touched: array<u32>;
@group(0) @binding(5) var<storage, read_write> depth_keys: array<u32>;
// Gaussians by rank of depth.
@group(0) @binding(6) var<storage, read_write> order: array<u32>;
// Where the pairs of a rank start; one more entry than Gaussians.
@group(0) @binding(7) var<storage, read_write> offsets: array<u32>;

// Tile and Gaussian of every pair, in order of rank, and the pair's own number to be sorted with its tile.
@group(0) @binding(8) var<storage, read_write> pair_tiles: array<u32>;
@group(0) @binding(9) var<storage, read_write> pair_ids: array<u32>;
@group(0) @binding(10) var<storage, read_write> owners: array<u32>;

// Gaussian i is drawn between two corners in pixels.
fn put_box(i: u32, low: vec2f, high: vec2f, depth: f32) {
    // Pixels whose centres lie between, and a little more than single precision may err.
    let size = vec2f(view.size);
    let start = vec2u(clamp(ceil(low - 0.51), vec2f(0.0), size));
    let stop = vec2u(clamp(floor(high - 0.49) + 1.0, vec2f(0.0), size));
    let first = start / TILE;
    let end = select(first, (stop + TILE - 1u) / TILE, vec2<bool>(all(start < stop)));
    boxes[i] = first | (end << vec2u(16u));
    var n = 0u;
    for (var r = first.y; r < end.y; r++) {
        for (var c = first.x; c < end.x; c++) {
            n += u32(touches(i, vec2u(c, r)));
        }
    }
    touched[i] = n;
    order[i] = i;
    depth_keys[i] = select(0xffffffffu, bitcast<u32>(depth), n > 0u);
}

fn put_nothing(i: u32) {
    boxes[i] = vec2u(0u);
    touched[i] = 0u;
    order[i] = i;
    depth_keys[i] = 0xffffffffu;
}

@compute @workgroup_size(256)
fn count_pairs(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let rank = line_index(id, groups);
    if rank < view.count {
        offsets[rank] = touched[order[rank]];
    } else if rank == view.count {
        offsets[rank] = 0u;
    }
}

@compute @workgroup_size(256)
fn list_pairs(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let rank = line_index(id, groups);
    if rank >= view.count {
        return;
    }
    let i = order[rank];
    let first = boxes[i] & vec2u(0xffffu);
    let end = boxes[i] >> vec2u(16u);
    var e = offsets[rank];
    let stop = offsets[rank + 1u];
    for (var r = first.y; r < end.y; r++) {
        for (var c = first.x; c < end.x && e < stop; c++) {
            if touches(i, vec2u(c, r)) {
                put_pair(e, i, r * view.tiles.x + c);
                e++;
            }
        }
    }
    // Should a compiler round `touches` differently here than above: pairs of no tile.
    for (; e < stop; e++) {
        put_pair(e, i, view.tiles.x * view.tiles.y);
    }
}

fn put_pair(e: u32, i: u32, tile: u32) {
    pair_tiles[e] = tile;
    pair_ids[e] = e;
    owners[e] = i;
}
