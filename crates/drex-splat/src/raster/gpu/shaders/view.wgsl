// The camera, the options and the parameters of the Gaussians; rotations and colours, and their derivatives.

struct View {
    // Rows of camera_from_world, the translation last.
    row_x: vec4f,
    row_y: vec4f,
    row_z: vec4f,
    // Where the camera stands, world frame.
    eye: vec4f,
    background: vec4f,
    focal: vec2f,
    principal: vec2f,
    // Range of x/z and of y/z in the Jacobian.
    limit_x: vec2f,
    limit_y: vec2f,
    near: f32,
    max_alpha: f32,
    blur: f32,
    centre_cutoff: f32,
    // Near and far of the distortion.
    range: vec2f,
    // Pixels, tiles.
    size: vec2u,
    tiles: vec2u,
    count: u32,
    // Coefficients a Gaussian has, and degree that is used.
    coefficients: u32,
    degree: u32,
    flags: u32,
}

const ANTIALIAS = 1u;
const RAY_DEPTH = 2u;
const GEOMETRY = 4u;
const SMOOTH = 8u;

const TILE = 16u;
const PIXELS = 256u;
const LINE = 256u;
const MIN_ALPHA = 1.0 / 255.0;
const MIN_TRANSMITTANCE = 1e-4;
// Half width of the band round MIN_ALPHA in which a splat fades out when the cut-off is smooth, relative.
const FADE = 0.5;
// Splats with numbers beyond these are not drawn, so that nothing overflows: coordinates (scene units), footprint
// (pixels), brightness.
const FARTHEST = 1e8;
const WIDEST = 1e8;
const BRIGHTEST = 1e9;

@group(0) @binding(0) var<uniform> view: View;
// Means 3, quaternions 4, logarithms of scales 3, logits 1, coefficients: each section for all Gaussians.
@group(0) @binding(1) var<storage, read> parameters: array<f32>;

// Number of a thread in a dispatch of rows of workgroups.
fn line_index(id: vec3u, groups: vec3u) -> u32 {
    return id.x + id.y * groups.x * LINE;
}

fn has(flag: u32) -> bool {
    return (view.flags & flag) != 0u;
}

fn load3(section: u32, i: u32) -> vec3f {
    let at = section * view.count + 3u * i;
    return vec3f(parameters[at], parameters[at + 1u], parameters[at + 2u]);
}

fn mean_of(i: u32) -> vec3f {
    return load3(0u, i);
}

// w, x, y, z as stored.
fn quaternion_of(i: u32) -> vec4f {
    let at = 3u * view.count + 4u * i;
    return vec4f(parameters[at], parameters[at + 1u], parameters[at + 2u], parameters[at + 3u]);
}

fn scales_of(i: u32) -> vec3f {
    return exp(clamp(load3(7u, i), vec3f(-60.0), vec3f(60.0)));
}

fn opacity_of(i: u32) -> f32 {
    return 1.0 / (1.0 + exp(-clamp(parameters[10u * view.count + i], -80.0, 80.0)));
}

// Opacity under which a splat does not touch a pixel.
fn least_alpha() -> f32 {
    return select(MIN_ALPHA, (1.0 - FADE) * MIN_ALPHA, has(SMOOTH));
}

// Largest power, -ln of a splat's fall from its centre, at which a splat still touches a pixel.
fn largest_power(opacity: f32) -> f32 {
    return log(opacity / least_alpha());
}

fn camera_rotation() -> mat3x3f {
    return transpose(mat3x3f(view.row_x.xyz, view.row_y.xyz, view.row_z.xyz));
}

fn to_camera(p: vec3f) -> vec3f {
    let h = vec4f(p, 1.0);
    return vec3f(dot(view.row_x, h), dot(view.row_y, h), dot(view.row_z, h));
}

fn largest(v: vec3f) -> f32 {
    return max(max(abs(v.x), abs(v.y)), abs(v.z));
}

// Length of a quaternion; 0 where it is too short to have a direction.
fn length_of(q: vec4f) -> f32 {
    let m = max(largest(q.xyz), abs(q.w));
    if m < 1e-30 {
        return 0.0;
    }
    return m * length(q / m);
}

// Rotation of a unit quaternion.
fn rotation(q: vec4f) -> mat3x3f {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    return mat3x3f(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y),
    );
}

// From the derivative d by the rotation's columns to that by the quaternion before its normalisation.
fn rotation_backward(q: vec4f, norm: f32, d: mat3x3f) -> vec4f {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    // d[c][r]; sums and differences of mirrored entries.
    let yx = d[0][1] + d[1][0];
    let zx = d[0][2] + d[2][0];
    let zy = d[1][2] + d[2][1];
    let cx = d[1][2] - d[2][1];
    let cy = d[2][0] - d[0][2];
    let cz = d[0][1] - d[1][0];
    let g = 2.0 * vec4f(
        x * cx + y * cy + z * cz,
        w * cx + y * yx + z * zx - 2.0 * x * (d[1][1] + d[2][2]),
        w * cy + x * yx + z * zy - 2.0 * y * (d[0][0] + d[2][2]),
        w * cz + x * zx + y * zy - 2.0 * z * (d[0][0] + d[1][1]),
    );
    return (g - q * dot(q, g)) / norm;
}

const C0 = 0.28209479177;
const C1 = 0.48860251190;
const C2A = 1.09254843059;
const C2B = 0.31539156525;
const C2C = 0.54627421529;
const C3A = 0.59004358993;
const C3B = 2.89061144264;
const C3C = 0.45704579946;
const C3D = 0.37317633259;
const C3E = 1.44530572132;

// Real spherical harmonics at a unit direction.
fn harmonics(d: vec3f) -> array<f32, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return array<f32, 16>(
        C0,
        -C1 * y, C1 * z, -C1 * x,
        C2A * x * y, -C2A * y * z, C2B * (2.0 * zz - xx - yy), -C2A * x * z, C2C * (xx - yy),
        -C3A * y * (3.0 * xx - yy), C3B * x * y * z, -C3C * y * (4.0 * zz - xx - yy),
        C3D * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -C3C * x * (4.0 * zz - xx - yy), C3E * z * (xx - yy),
        -C3A * x * (xx - 3.0 * yy),
    );
}

// Derivative by the direction of the sum of w_k basis_k.
fn harmonics_backward(d: vec3f, w: ptr<function, array<f32, 16>>) -> vec3f {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    var g = C1 * vec3f(-(*w)[3], -(*w)[1], (*w)[2]);
    g += C2A * ((*w)[4] * vec3f(y, x, 0.0) - (*w)[5] * vec3f(0.0, z, y) - (*w)[7] * vec3f(z, 0.0, x));
    g += 2.0 * C2B * (*w)[6] * vec3f(-x, -y, 2.0 * z) + 2.0 * C2C * (*w)[8] * vec3f(x, -y, 0.0);
    g -= 3.0 * C3A * ((*w)[9] * vec3f(2.0 * x * y, xx - yy, 0.0) + (*w)[15] * vec3f(xx - yy, -2.0 * x * y, 0.0));
    g += C3B * (*w)[10] * vec3f(y * z, x * z, x * y);
    g -= C3C * ((*w)[11] * vec3f(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z)
        + (*w)[13] * vec3f(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z));
    g += C3D * (*w)[12] * vec3f(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy);
    g += C3E * (*w)[14] * vec3f(2.0 * x * z, -2.0 * y * z, xx - yy);
    return g;
}

fn coefficient_of(i: u32, k: u32) -> vec3f {
    let at = 11u * view.count + 3u * (i * view.coefficients + k);
    return clamp(vec3f(parameters[at], parameters[at + 1u], parameters[at + 2u]), vec3f(-1e12), vec3f(1e12));
}

// Direction from the camera to a mean, and 1 / distance; zero at the camera itself.
fn sight(mean: vec3f) -> vec4f {
    let v = mean - view.eye.xyz;
    let r = length(v);
    if r < 1e-30 {
        return vec4f(0.0);
    }
    return vec4f(v / r, 1.0 / r);
}

fn colour_of(i: u32, mean: vec3f) -> vec3f {
    var basis = harmonics(sight(mean).xyz);
    var c = vec3f(0.5);
    for (var k = 0u; k < (view.degree + 1u) * (view.degree + 1u); k++) {
        c += basis[k] * coefficient_of(i, k);
    }
    return max(c, vec3f(0.0));
}
