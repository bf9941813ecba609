// What drawing and its backward share: the lists, the images, and the pixel's state.

@group(0) @binding(2) var<storage, read> footprints: array<vec4f>;
@group(0) @binding(3) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(4) var<storage, read> splats: array<u32>;
// Colour 3, alpha, depth, normal 3, median depth, distortion, count: each section for all pixels.
@group(0) @binding(5) var<storage, read_write> images: array<f32>;
// Transmittance that is left; for surfels 1/z of the first splat, Σ w m, Σ w m².
@group(0) @binding(6) var<storage, read_write> marks: array<vec4f>;
// How far into the list the pixel went, and place of the splat of median depth + 1.
@group(0) @binding(7) var<storage, read_write> ends: array<vec2u>;

@group(0) @binding(8) var<storage, read> kept_marks: array<vec4f>;
@group(0) @binding(9) var<storage, read> kept_ends: array<vec2u>;
// Where the record of a sorted pair goes.
@group(0) @binding(10) var<storage, read> pair_ids: array<u32>;
// Derivative of the loss by `images`, without the count.
@group(0) @binding(11) var<storage, read> by_images: array<f32>;
@group(0) @binding(12) var<storage, read_write> records: array<f32>;

// Threads of a workgroup of the backward: each has a splat of its own and walks over the tile's pixels, one pixel
// behind the thread before it. So every pixel meets the splats in the order of the list, and every splat's sums are
// made by one thread in the order of the pixels.
const WALKERS = 64u;

// Transmittance behind the splat that comes next, and the part of the loss that lies behind it.
var<workgroup> behind: array<vec2f, 256>;
var<workgroup> end_of: array<u32, 256>;
var<workgroup> by_colour: array<vec4f, 256>;
// Zero at the start, as all memory of a workgroup.
var<workgroup> longest: atomic<u32>;

// Opacity of a splat where it is `full` before any limit, 0 where the pixel is not touched; and its derivative by ln full,
// 0 where it is limited. A smooth cut-off multiplies by x³ (10 - 15 x + 6 x²), x rising from 0 to 1 over the
// band.
fn opacity(full: f32) -> vec2f {
    if full < least_alpha() {
        return vec2f(0.0);
    }
    let alpha = min(full, view.max_alpha);
    let slope = select(0.0, full, full < view.max_alpha);
    if !has(SMOOTH) {
        return vec2f(alpha, slope);
    }
    let per_alpha = 1.0 / (2.0 * FADE * MIN_ALPHA);
    let x = clamp((alpha - least_alpha()) * per_alpha, 0.0, 1.0);
    let fade = x * x * x * (10.0 - x * (15.0 - 6.0 * x));
    let fade_slope = 30.0 * x * x * (1.0 - x) * (1.0 - x) * per_alpha;
    return vec2f(alpha * fade, slope * (fade + alpha * fade_slope));
}

fn pixel_count() -> u32 {
    return view.size.x * view.size.y;
}

fn put3(section: u32, pixel: u32, value: vec3f) {
    let at = section * pixel_count() + 3u * pixel;
    images[at] = value.x;
    images[at + 1u] = value.y;
    images[at + 2u] = value.z;
}

fn put1(section: u32, pixel: u32, value: f32) {
    images[section * pixel_count() + pixel] = value;
}

fn by3(section: u32, pixel: u32) -> vec3f {
    let at = section * pixel_count() + 3u * pixel;
    return vec3f(by_images[at], by_images[at + 1u], by_images[at + 2u]);
}

fn by1(section: u32, pixel: u32) -> f32 {
    return by_images[section * pixel_count() + pixel];
}

fn inside(pixel: vec2u) -> bool {
    return all(pixel < view.size);
}

// Loads what the backward needs of pixel `p` of the tile: colours, end and start of the walk.
fn load_pixel(p: u32, pixel: vec2u) {
    let i = pixel.y * view.size.x + pixel.x;
    if !inside(pixel) {
        end_of[p] = 0u;
        return;
    }
    let left = kept_marks[i].x;
    by_colour[p] = vec4f(by3(0u, i), by1(3u, i));
    behind[p] = vec2f(left, left * dot(by_colour[p].rgb, view.background.rgb));
    end_of[p] = kept_ends[i].x;
    atomicMax(&longest, kept_ends[i].x);
}
