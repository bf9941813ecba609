// First and end of every tile in the sorted pairs, and the Gaussian of every sorted pair.

@group(0) @binding(0) var<uniform> sizes: vec4u; // pairs, tiles
@group(0) @binding(1) var<storage, read> sorted_tiles: array<u32>;
@group(0) @binding(2) var<storage, read> sorted_ids: array<u32>;
@group(0) @binding(3) var<storage, read> owners: array<u32>;
@group(0) @binding(4) var<storage, read_write> ranges: array<vec2u>;
@group(0) @binding(5) var<storage, read_write> splats: array<u32>;

@compute @workgroup_size(256)
fn find_ranges(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let s = id.x + id.y * groups.x * 256u;
    if s >= sizes.x {
        return;
    }
    splats[s] = owners[sorted_ids[s]];
    let tile = sorted_tiles[s];
    if tile >= sizes.y {
        return;
    }
    if s == 0u || sorted_tiles[s - 1u] != tile {
        ranges[tile].x = s;
    }
    if s + 1u == sizes.x || sorted_tiles[s + 1u] != tile {
        ranges[tile].y = s + 1u;
    }
}
