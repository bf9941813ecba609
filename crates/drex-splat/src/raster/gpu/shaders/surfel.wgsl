// A surfel as the camera sees it (2DGS, Huang et al. 2024): the rows Tu, Tv, Tw of the homography z (x, y, 1) = T (u, v, 1)
// from the disc, in standard deviations, to the image. Pixels are counted from an origin near the centre, a whole
// number, so that single precision keeps the digits of a small splat in a large image.

struct Surfel {
    drawn: bool,
    t: vec3f,
    q: vec4f,
    norm: f32,
    // Axes of the disc, camera frame, and standard deviations along the first two.
    r: mat3x3f,
    s: vec2f,
    // 1, or -1 where the third axis points away from the camera.
    flip: f32,
    origin: vec2f,
    tu: vec3f,
    tv: vec3f,
    tw: vec3f,
    // Centre of the screen-space floor, from the origin; far away where the disc reaches the camera's plane.
    centre: vec2f,
}

const NOWHERE = 1e9;
// Standard deviations are kept between these, times depth (over the focal length for the smaller): less than a millionth
// of a pixel is drawn by the floor, more is a plane.
const NARROWEST_SURFEL = 1e-6;
const WIDEST_SURFEL = 1e6;

fn surfel(i: u32) -> Surfel {
    var e: Surfel;
    let mean = mean_of(i);
    e.t = to_camera(mean);
    let q = quaternion_of(i);
    e.norm = length_of(q);
    if !(e.t.z > view.near && largest(mean) < FARTHEST && e.norm > 0.0) {
        return e;
    }
    e.q = q / e.norm;
    e.r = camera_rotation() * rotation(e.q);
    let narrowest = NARROWEST_SURFEL * e.t.z / max(view.focal.x, view.focal.y);
    e.s = clamp(scales_of(i).xy, vec2f(narrowest), vec2f(WIDEST_SURFEL * e.t.z));
    e.flip = select(1.0, -1.0, dot(e.r[2], e.t) > 0.0);
    let centre = view.focal * e.t.xy / e.t.z + view.principal;
    let size = vec2f(view.size);
    e.origin = floor(clamp(centre, -size, 2.0 * size));
    let u = e.s.x * e.r[0];
    let v = e.s.y * e.r[1];
    let h = transpose(mat3x3f(u, v, e.t));
    let c = view.principal - e.origin;
    e.tu = view.focal.x * h[0] + c.x * h[2];
    e.tv = view.focal.y * h[1] + c.y * h[2];
    e.tw = h[2];
    e.centre = vec2f(NOWHERE);
    let w = box_weights(e.tw, view.centre_cutoff);
    if w.w < 0.0 {
        e.centre = vec2f(dot(w.xyz, e.tu * e.tw), dot(w.xyz, e.tv * e.tw));
    }
    e.drawn = true;
    return e;
}

// f = d / (d · Tw²) with d = (c², c², -1): f · (Tu Tw) is the middle of the box of the disc of radius c. Last: the
// denominator over z², not negative where the disc reaches the camera's plane.
fn box_weights(tw: vec3f, c2: f32) -> vec4f {
    let d = vec3f(c2, c2, -1.0);
    let norm = dot(d, tw * tw);
    return vec4f(d / min(norm, -1e-30), norm / (tw.z * tw.z));
}
