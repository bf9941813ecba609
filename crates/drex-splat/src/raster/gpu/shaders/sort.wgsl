// A stable radix sort of keys with a payload, four bits at a time, and the prefix sum it needs. Every thread counts and
// scatters a run of its own, so the order is fixed and nothing is shared.

const RUN = 32u;
const DIGITS = 16u;
const SCAN_RUN = 8u;
const SCAN_BLOCK = 2048u;

@group(0) @binding(0) var<uniform> step: vec4u; // length, threads, shift
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<u32>;
// Digit by digit, thread by thread: first how many, after the prefix sum where they go.
@group(0) @binding(3) var<storage, read_write> table: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> values_out: array<u32>;

fn index(id: vec3u, groups: vec3u) -> u32 {
    return id.x + id.y * groups.x * 256u;
}

fn digit(s: u32) -> u32 {
    return (keys[s] >> step.z) & (DIGITS - 1u);
}

@compute @workgroup_size(256)
fn count_digits(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let thread = index(id, groups);
    if thread >= step.y {
        return;
    }
    var n: array<u32, 16>;
    for (var s = thread * RUN; s < min((thread + 1u) * RUN, step.x); s++) {
        n[digit(s)]++;
    }
    for (var d = 0u; d < DIGITS; d++) {
        table[d * step.y + thread] = n[d];
    }
}

@compute @workgroup_size(256)
fn scatter(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let thread = index(id, groups);
    if thread >= step.y {
        return;
    }
    var to: array<u32, 16>;
    for (var d = 0u; d < DIGITS; d++) {
        to[d] = table[d * step.y + thread];
    }
    for (var s = thread * RUN; s < min((thread + 1u) * RUN, step.x); s++) {
        let d = digit(s);
        keys_out[to[d]] = keys[s];
        values_out[to[d]] = values[s];
        to[d]++;
    }
}

@group(0) @binding(6) var<storage, read_write> sums: array<u32>;
@group(0) @binding(7) var<storage, read_write> block_sums: array<u32>;

// A sum too large for 32 bits stays at their largest number, so that the host sees that it does not fit.
fn add(a: u32, b: u32) -> u32 {
    return a + min(b, ~a);
}

var<workgroup> partial: array<u32, 256>;

// Exclusive prefix sum of `sums` within blocks, and the blocks' totals.
@compute @workgroup_size(256)
fn scan_blocks(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = group.x + group.y * groups.x;
    let first = block * SCAN_BLOCK + local * SCAN_RUN;
    var total = 0u;
    for (var s = first; s < min(first + SCAN_RUN, step.x); s++) {
        total = add(total, sums[s]);
    }
    partial[local] = total;
    workgroupBarrier();
    for (var reach = 1u; reach < 256u; reach *= 2u) {
        var sum = partial[local];
        if local >= reach {
            sum = add(sum, partial[local - reach]);
        }
        workgroupBarrier();
        partial[local] = sum;
        workgroupBarrier();
    }
    var before = 0u;
    if local > 0u {
        before = partial[local - 1u];
    }
    for (var s = first; s < min(first + SCAN_RUN, step.x); s++) {
        let here = sums[s];
        sums[s] = before;
        before = add(before, here);
    }
    if local == 255u && block * SCAN_BLOCK < step.x {
        block_sums[block] = partial[255u];
    }
}

@compute @workgroup_size(256)
fn add_blocks(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let s = index(id, groups);
    if s < step.x {
        sums[s] = add(sums[s], block_sums[s / SCAN_BLOCK]);
    }
}
