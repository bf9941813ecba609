// From the sums over pixels to the parameters of a surfel and the motion of the camera.

const RECORD = 21u;

@compute @workgroup_size(256)
fn project_back(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let rank = line_index(id, groups);
    if rank >= view.count || offsets[rank] == offsets[rank + 1u] {
        return;
    }
    var sum: array<f32, 21>;
    for (var e = offsets[rank]; e < offsets[rank + 1u]; e++) {
        for (var k = 0u; k < RECORD; k++) {
            sum[k] += records[RECORD * e + k];
        }
    }
    let i = order[rank];
    let e = surfel(i);
    var by_tu = vec3f(sum[0], sum[1], sum[2]);
    var by_tv = vec3f(sum[3], sum[4], sum[5]);
    var by_tw = vec3f(sum[6], sum[7], sum[8]);
    let by_normal = vec3f(sum[12], sum[13], sum[14]);
    let by_floor = vec2f(sum[15], sum[16]);
    // The whole splat moved in the image: Tu + δ Tw.
    let by_centre = by_floor + vec2f(dot(by_tu, e.tw), dot(by_tv, e.tw));
    put_statistics(i, by_centre, vec2f(sum[17], sum[18]), radius_of(e, largest_power(opacity_of(i))));
    put_opacity_gradient(i, sum[19]);

    // Through the floor's centre f · (Tu Tw), f · (Tv Tw).
    let f = box_weights(e.tw, view.centre_cutoff);
    if f.w < 0.0 {
        let by_f_tw = by_floor.x * e.tu + by_floor.y * e.tv;
        let d = vec3f(view.centre_cutoff, view.centre_cutoff, -1.0);
        let by_norm = -dot(by_f_tw * e.tw, f.xyz) / dot(d, e.tw * e.tw);
        by_tu += by_floor.x * f.xyz * e.tw;
        by_tv += by_floor.y * f.xyz * e.tw;
        by_tw += f.xyz * by_f_tw + 2.0 * by_norm * d * e.tw;
    }

    // T = K H, H = (s_u r_u, s_v r_v, t).
    let c = view.principal - e.origin;
    let by_h = transpose(mat3x3f(
        view.focal.x * by_tu,
        view.focal.y * by_tv,
        c.x * by_tu + c.y * by_tv + by_tw,
    ));
    let by_t = by_h[2] + vec3f(0.0, 0.0, sum[20]);
    let r = camera_rotation();
    let by_r = mat3x3f(e.s.x * by_h[0], e.s.y * by_h[1], e.flip * by_normal);
    put_quaternion_gradient(i, rotation_backward(e.q, e.norm, transpose(r) * by_r));
    put_gradient3(7u, i, vec3f(dot(e.r[0], by_r[0]), dot(e.r[1], by_r[1]), 0.0));

    let by_sight = colour_backward(i, mean_of(i), vec3f(sum[9], sum[10], sum[11]));
    put_gradient3(0u, i, transpose(r) * by_t + by_sight);
    let turn = cross(e.r[0], by_r[0]) + cross(e.r[1], by_r[1]) + cross(e.r[2], by_r[2]);
    put_twist(i, by_t + r * by_sight, cross(e.t, by_t) + turn);
}
