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

// Where a surfel can touch the image, pixels from its origin: a box, and a strip across it along the direction in which
// the projected disc is thinnest. Holds the disc of squared radius 2 `power` and the floor's spot (σ = √½ px).
struct Reach {
    low: vec2f,
    high: vec2f,
    axis: vec2f,
    strip: vec2f,
}

// A disc that all but touches the camera's plane has an ellipse too large for these digits.
const TOUCHES_PLANE = -1e-4;

// The ellipse (x - c)ᵀ Γ⁻¹ (x - c) = 1 that the disc of squared radius r² projects to, from the dual conic
// T diag(r², r², -1) Tᵀ: diagonal of Γ and the entry beside it. Not whole where the disc reaches the camera's plane.
struct Ellipse {
    whole: bool,
    c: vec2f,
    square: vec2f,
    mixed: f32,
}

fn ellipse_of(e: Surfel, r2: f32) -> Ellipse {
    let w = box_weights(e.tw, r2);
    let c = vec2f(dot(w.xyz, e.tu * e.tw), dot(w.xyz, e.tv * e.tw));
    let square = c * c - vec2f(dot(w.xyz, e.tu * e.tu), dot(w.xyz, e.tv * e.tv));
    return Ellipse(w.w < TOUCHES_PLANE, c, square, c.x * c.y - dot(w.xyz, e.tu * e.tv));
}

fn reach_of(e: Surfel, power: f32) -> Reach {
    var reach: Reach;
    let disc = ellipse_of(e, 2.0 * power);
    if disc.whole {
        let c = disc.c;
        let square = disc.square;
        let mixed = disc.mixed;
        let angle = 0.5 * atan2(2.0 * mixed, square.x - square.y);
        let n = vec2f(-sin(angle), cos(angle));
        // More than single precision can err.
        let margin = 1e-5 * (dot(c, c) + abs(square.x) + abs(square.y) + 1.0);
        let half = sqrt(max(square, vec2f(0.0)) + margin);
        let thin = sqrt(max(dot(n * n, square) + 2.0 * n.x * n.y * mixed, 0.0) + margin);
        reach = Reach(c - half, c + half, n, dot(n, c) + vec2f(-thin, thin));
    } else {
        reach = cut_reach(e, sqrt(2.0 * power));
    }
    if e.centre.x < NOWHERE {
        let spot = sqrt(power) + 0.05;
        reach.low = min(reach.low, e.centre - spot);
        reach.high = max(reach.high, e.centre + spot);
        let at = dot(reach.axis, e.centre);
        reach.strip = vec2f(min(reach.strip.x, at - spot), max(reach.strip.y, at + spot));
    }
    return reach;
}

const CORNERS = 16u;

// Of a disc that reaches the camera's plane: the hull of a polygon round it, cut at z = near and projected.
fn cut_reach(e: Surfel, radius: f32) -> Reach {
    let turn = 6.2831853 / f32(CORNERS);
    let outer = radius / cos(0.5 * turn);
    var low = vec2f(1e30);
    var high = vec2f(-1e30);
    var a = corner(e, outer, 0.0);
    for (var k = 1u; k <= CORNERS; k++) {
        let b = corner(e, outer, turn * f32(k));
        if a.z >= view.near {
            low = min(low, a.xy / a.z);
            high = max(high, a.xy / a.z);
        }
        if (a.z >= view.near) != (b.z >= view.near) {
            let cut = (a + (b - a) * ((view.near - a.z) / (b.z - a.z))).xy / view.near;
            low = min(low, cut);
            high = max(high, cut);
        }
        a = b;
    }
    let margin = 1e-4 * (high - low) + 0.05;
    return Reach(low - margin, high + margin, vec2f(1.0, 0.0), vec2f(low.x - margin.x, high.x + margin.x));
}

// z (x, y, 1) of a point on the rim.
fn corner(e: Surfel, radius: f32, angle: f32) -> vec3f {
    let p = vec3f(radius * cos(angle), radius * sin(angle), 1.0);
    return vec3f(dot(e.tu, p), dot(e.tv, p), dot(e.tw, p));
}

// Three standard deviations of the disc or of the floor along the longest axis, pixels; the longer side of the box where
// the disc reaches the camera's plane.
fn radius_of(e: Surfel, power: f32) -> f32 {
    let disc = ellipse_of(e, 9.0);
    if disc.whole {
        let half = 0.5 * (disc.square.x - disc.square.y);
        let longest = 0.5 * (disc.square.x + disc.square.y) + length(vec2f(half, disc.mixed));
        return sqrt(max(longest, 4.5));
    }
    let reach = reach_of(e, power);
    return max(reach.high.x - reach.low.x, reach.high.y - reach.low.y);
}
