// What both kinds need to go from a Gaussian's sums over pixels to its parameters.

@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> offsets: array<u32>;
@group(0) @binding(4) var<storage, read> records: array<f32>;
// As `parameters`, then centre in the image 2, its absolute values 2, radius 1, twist 6.
@group(0) @binding(5) var<storage, read_write> gradients: array<f32>;

fn put_gradient3(section: u32, i: u32, g: vec3f) {
    let at = section * view.count + 3u * i;
    gradients[at] = g.x;
    gradients[at + 1u] = g.y;
    gradients[at + 2u] = g.z;
}

fn put_quaternion_gradient(i: u32, g: vec4f) {
    let at = 3u * view.count + 4u * i;
    gradients[at] = g.x;
    gradients[at + 1u] = g.y;
    gradients[at + 2u] = g.z;
    gradients[at + 3u] = g.w;
}

// By the logit, from the derivative by the sigmoid.
fn put_opacity_gradient(i: u32, by_opacity: f32) {
    let o = opacity_of(i);
    gradients[10u * view.count + i] = by_opacity * o * (1.0 - o);
}

fn put_statistics(i: u32, centre: vec2f, abs_centre: vec2f, radius: f32) {
    let section = (11u + 3u * view.coefficients) * view.count;
    gradients[section + 2u * i] = centre.x;
    gradients[section + 2u * i + 1u] = centre.y;
    gradients[section + 2u * view.count + 2u * i] = abs_centre.x;
    gradients[section + 2u * view.count + 2u * i + 1u] = abs_centre.y;
    gradients[section + 4u * view.count + i] = radius;
}

fn put_twist(i: u32, rho: vec3f, phi: vec3f) {
    let section = 16u + 3u * view.coefficients;
    let at = section * view.count + 6u * i;
    gradients[at] = rho.x;
    gradients[at + 1u] = rho.y;
    gradients[at + 2u] = rho.z;
    gradients[at + 3u] = phi.x;
    gradients[at + 4u] = phi.y;
    gradients[at + 5u] = phi.z;
}

// Writes the derivative by the coefficients; gives that by the mean through the direction, world frame.
fn colour_backward(i: u32, mean: vec3f, by_colour: vec3f) -> vec3f {
    let to = sight(mean);
    var basis = harmonics(to.xyz);
    let by = select(vec3f(0.0), by_colour, colour_of(i, mean) > vec3f(0.0));
    var by_basis: array<f32, 16>;
    for (var k = 0u; k < (view.degree + 1u) * (view.degree + 1u); k++) {
        put_gradient3(11u, i * view.coefficients + k, by * basis[k]);
        by_basis[k] = dot(by, coefficient_of(i, k));
    }
    if view.degree == 0u {
        return vec3f(0.0);
    }
    let g = harmonics_backward(to.xyz, &by_basis);
    return (g - to.xyz * dot(to.xyz, g)) * to.w;
}
