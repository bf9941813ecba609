// An ellipsoid as the camera sees it (EWA splatting, Zwicker et al. 2001; Kerbl et al. 2023): A = J R M with
// M = rot(q) diag(s), and Σ = A Aᵀ + blur.

struct Ellipsoid {
    drawn: bool,
    t: vec3f,
    q: vec4f,
    norm: f32,
    // R M, camera frame.
    b: mat3x3f,
    // x/z and y/z, kept within the limits.
    slope: vec2f,
    // Rows of J and of A.
    j0: vec3f,
    j1: vec3f,
    a0: vec3f,
    a1: vec3f,
    // Σ (xx, xy, yy), its determinant, and that before the blur.
    cov: vec3f,
    det: f32,
    sharp_det: f32,
    compensation: f32,
}

fn ellipsoid(i: u32) -> Ellipsoid {
    var e: Ellipsoid;
    let mean = mean_of(i);
    e.t = to_camera(mean);
    let q = quaternion_of(i);
    e.norm = length_of(q);
    if !(e.t.z > view.near && largest(mean) < FARTHEST && e.norm > 0.0) {
        return e;
    }
    e.q = q / e.norm;
    let s = scales_of(i);
    let r = camera_rotation() * rotation(e.q);
    e.b = mat3x3f(r[0] * s.x, r[1] * s.y, r[2] * s.z);
    e.slope = vec2f(
        clamp(e.t.x / e.t.z, view.limit_x.x, view.limit_x.y),
        clamp(e.t.y / e.t.z, view.limit_y.x, view.limit_y.y),
    );
    let f = view.focal / e.t.z;
    e.j0 = vec3f(f.x, 0.0, -f.x * e.slope.x);
    e.j1 = vec3f(0.0, f.y, -f.y * e.slope.y);
    e.a0 = e.j0 * e.b;
    e.a1 = e.j1 * e.b;
    if !(largest(e.a0) < WIDEST && largest(e.a1) < WIDEST) {
        return e;
    }
    let xx = dot(e.a0, e.a0);
    let yy = dot(e.a1, e.a1);
    // det A Aᵀ without the difference of two products (Lagrange).
    let normal = cross(e.a0, e.a1);
    e.sharp_det = dot(normal, normal);
    e.det = e.sharp_det + view.blur * (xx + yy) + view.blur * view.blur;
    e.cov = vec3f(xx + view.blur, dot(e.a0, e.a1), yy + view.blur);
    e.compensation = 1.0;
    if has(ANTIALIAS) {
        e.compensation = sqrt(e.sharp_det / e.det);
    }
    // Blur may be zero: a needle whose inverse leaves single precision.
    e.drawn = e.det > 1e-18 * max(e.cov.x, e.cov.z) && e.det > 1e-30;
    return e;
}
