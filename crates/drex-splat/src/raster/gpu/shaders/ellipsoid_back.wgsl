// From the sums over pixels to the parameters of an ellipsoid and the motion of the camera.

const RECORD = 12u;

@compute @workgroup_size(256)
fn project_back(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let rank = line_index(id, groups);
    if rank >= view.count || offsets[rank] == offsets[rank + 1u] {
        return;
    }
    var sum: array<f32, 12>;
    for (var e = offsets[rank]; e < offsets[rank + 1u]; e++) {
        for (var k = 0u; k < RECORD; k++) {
            sum[k] += records[RECORD * e + k];
        }
    }
    let i = order[rank];
    let by_centre = vec2f(sum[0], sum[1]);
    let e = ellipsoid(i);
    // Three standard deviations along the longer axis.
    let middle = 0.5 * (e.cov.x + e.cov.z);
    let radius = 3.0 * sqrt(middle + length(vec2f(0.5 * (e.cov.x - e.cov.z), e.cov.y)));
    put_statistics(i, by_centre, vec2f(sum[2], sum[3]), radius);
    put_opacity_gradient(i, sum[7] * e.compensation);

    // Q = Σ⁻¹: dL/dΣ = -Q (dL/dQ) Q, all symmetric.
    let q = vec3f(e.cov.z, -e.cov.y, e.cov.x) / e.det;
    let by_q = mat2x2f(sum[4], 0.5 * sum[5], 0.5 * sum[5], sum[6]);
    let conic = mat2x2f(q.x, q.y, q.y, q.z);
    var by_cov = -1.0 * (conic * by_q * conic);
    if has(ANTIALIAS) && e.compensation > 1e-6 {
        // c² = det₀ / det; derivatives of the two determinants by Σ.
        let c2 = e.compensation * e.compensation;
        let by_c = sum[7] * opacity_of(i) / (2.0 * e.compensation * e.det);
        let sharp = vec2f(e.cov.z, e.cov.x) - view.blur;
        let on_diagonal = by_c * (sharp - c2 * vec2f(e.cov.z, e.cov.x));
        let off_diagonal = -by_c * e.cov.y * (1.0 - c2);
        by_cov += mat2x2f(on_diagonal.x, off_diagonal, off_diagonal, on_diagonal.y);
    }

    // Σ = A Aᵀ, A = J B, B = R M.
    let by_a0 = 2.0 * (by_cov[0].x * e.a0 + by_cov[1].x * e.a1);
    let by_a1 = 2.0 * (by_cov[0].y * e.a0 + by_cov[1].y * e.a1);
    var by_b: mat3x3f;
    for (var k = 0u; k < 3u; k++) {
        by_b[k] = e.j0 * by_a0[k] + e.j1 * by_a1[k];
    }
    let by_j0 = e.b * by_a0;
    let by_j1 = e.b * by_a1;

    let f = view.focal / e.t.z;
    let free = vec2f(
        f32(e.t.x / e.t.z == e.slope.x),
        f32(e.t.y / e.t.z == e.slope.y),
    );
    let by_slope = vec2f(-f.x * by_j0.z, -f.y * by_j1.z) * free;
    var by_t = vec3f((by_centre * view.focal + by_slope) / e.t.z, sum[11]);
    by_t.z -= dot(by_centre, f * e.t.xy / e.t.z) + dot(by_slope, e.t.xy) / (e.t.z * e.t.z);
    by_t.z -= (f.x * (by_j0.x - e.slope.x * by_j0.z) + f.y * (by_j1.y - e.slope.y * by_j1.z)) / e.t.z;

    let s = scales_of(i);
    let r = camera_rotation();
    let by_m = transpose(r) * by_b;
    put_quaternion_gradient(i, rotation_backward(e.q, e.norm, mat3x3f(by_m[0] * s.x, by_m[1] * s.y, by_m[2] * s.z)));
    put_gradient3(7u, i, vec3f(dot(e.b[0], by_b[0]), dot(e.b[1], by_b[1]), dot(e.b[2], by_b[2])));

    let by_sight = colour_backward(i, mean_of(i), vec3f(sum[8], sum[9], sum[10]));
    put_gradient3(0u, i, transpose(r) * by_t + by_sight);
    let turn = cross(e.b[0], by_b[0]) + cross(e.b[1], by_b[1]) + cross(e.b[2], by_b[2]);
    put_twist(i, by_t + r * by_sight, cross(e.t, by_t) + turn);
}
