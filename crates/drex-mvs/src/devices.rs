//! One suite for all that can run a pass: plain loops, the widest vectors of the machine, and the GPU where this build and machine have one.

use drex_core::Pose;
use drex_core::camera::PinholeCamera;

use crate::gpu::Gpu;
use crate::kernel::tests::waves;
use crate::kernel::{Plane, Source, Window};
use crate::patchmatch::{Field, Matcher, Pass, Peer, Scale};
use crate::picture::{Area, Grey, Quads};
use crate::scene::Limits;

/// A wall at inverse depth 1, of which most is searched.
struct Wall {
    window: Window<5>,
    camera: PinholeCamera,
    pictures: Vec<Grey>,
    searched: Vec<Area>,
}

const WIDTH: usize = 64;
const HEIGHT: usize = 48;
/// How the wall moves in the other photos.
const SHIFTS: [[f32; 3]; 4] = [[2.0, 0.0, 0.0], [-3.0, 0.0, 0.001], [1.0, 0.2, -0.001], [1.5, 0.0, 0.0]];

impl Wall {
    fn new() -> Self {
        let mut picture = waves(0.0);
        for (i, grey) in picture.values.iter_mut().enumerate() {
            let (x, y) = (i % WIDTH, i / WIDTH);
            // One corner shows nothing, another one so little that the smaller picture is asked.
            *grey = match (x > 44 && y > 28, x < 20 && y < 20) {
                (true, _) => 128,
                (_, true) => 112 + *grey / 8,
                _ => *grey,
            };
        }
        let inside = (0..WIDTH * HEIGHT).map(|i| i % WIDTH < 60 && i % 97 != 3).collect();
        let searched = Area { width: WIDTH, height: HEIGHT, inside };
        let (fx, fy, cx, cy) = (60.0, 60.0, 32.0, 24.0);
        let camera =
            PinholeCamera { camera_from_world: Pose::identity(), fx, fy, cx, cy, width: WIDTH, height: HEIGHT };
        Self {
            window: Window::new(5, 4.0, 25.5),
            camera,
            pictures: vec![picture.clone(), picture.halved()],
            searched: vec![searched.clone(), searched.halved()],
        }
    }

    fn limits(&self) -> Limits<'_> {
        Limits::new(&self.camera, [0.4, 4.0], None)
    }

    fn matcher<'a>(&'a self, limits: &'a Limits<'a>, shifts: &[[f32; 3]], peers: Vec<Peer>) -> Matcher<'a, 5> {
        let source = |[x, y, z]: [f32; 3], halvings: usize| {
            let size = 1.0 / (1 << halvings) as f32;
            let pictures = [waves(x), waves(x).halved()];
            let turn = [[1.0, 1e-3, 0.0], [0.0, 1.0, 1e-5 / size], [0.0, 0.0, 1.0]];
            Source { quads: Quads::new(&pictures[halvings]), turn, shift: [size * x, size * y, z] }
        };
        let scale = |halvings: usize| Scale {
            picture: &self.pictures[halvings],
            searched: &self.searched[halvings],
            least_variance: 40.0,
            noise_variance: 50.0,
            sources: shifts.iter().map(|shift| source(*shift, halvings)).collect(),
        };
        Matcher {
            window: &self.window,
            searched: &self.searched[0],
            scales: (0..2).map(scale).collect(),
            masked: true,
            weights: [1.0, 0.5, 0.8, 0.7][..shifts.len()].to_vec(),
            peers,
            focal: [60.0; 2],
            centre: [31.5, 23.5],
            limits,
            halvings: 0,
            disparity: 2.0,
            seed: 0x1234_5678_9abc_def0,
        }
    }

    /// What the other photos know of the wall: a little of it wrong.
    fn peers(&self) -> Vec<Peer> {
        let known = |i: usize, shift: [f32; 3]| {
            let mut field = self.noise(0.05, 1.0 + i as f32);
            field.costs.iter_mut().step_by(11).for_each(|cost| *cost = f32::INFINITY);
            let turn = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            Peer { field: field.into(), turn, shift: shift.map(|v| -v) }
        };
        SHIFTS.iter().enumerate().map(|(i, shift)| known(i, *shift)).collect()
    }

    /// Planes near the wall, and costs, infinite where nothing is searched.
    fn noise(&self, size: f32, phase: f32) -> Field {
        let noise = |i: usize, k: f32| (i as f32 * (1.7 + k) + phase).sin();
        let plane = |i: usize| Plane {
            w: 1.0 + size * noise(i, 0.1),
            a: 0.02 * size * noise(i, 0.2),
            b: 0.02 * size * noise(i, 0.3),
        };
        let cost = |i: usize| if self.searched[0].inside[i] { 1.0 + noise(i, 0.4) } else { f32::INFINITY };
        let all = 0..WIDTH * HEIGHT;
        Field { width: WIDTH, height: HEIGHT, planes: all.clone().map(plane).collect(), costs: all.map(cost).collect() }
    }
}

const AS_IS: Pass = Pass { number: 0, far: false, step_px: 0.0, restart: false, last: false };

/// The GPU; without an adapter prints why and gives `None`, unless DREX_REQUIRE_GPU is set.
fn gpu(window: &Window<5>) -> Option<Gpu> {
    match Gpu::new(window) {
        Ok(gpu) => Some(gpu),
        Err(e) => {
            assert!(!cfg!(feature = "wgpu") || std::env::var_os("DREX_REQUIRE_GPU").is_none(), "{e}");
            eprintln!("skipped: {e}");
            None
        }
    }
}

/// [`Matcher::pass`] in loops that are compiled as plain ones.
fn plain_pass(matcher: &Matcher<'_, 5>, field: &mut Field, pass: Pass) {
    for colour in 0..2 {
        for at in (0..WIDTH * HEIGHT).filter(|at| (at / WIDTH + at % WIDTH) % 2 == colour) {
            if matcher.searched.inside[at] {
                (field.planes[at], field.costs[at]) = matcher.pixel(field, pass, at % WIDTH, at / WIDTH);
            }
        }
    }
}

/// Share of the numbers that agree to `limit`, or are both infinite.
fn agree(a: &[f32], b: &[f32], limit: f32) -> f64 {
    let same = a.iter().zip(b).filter(|(a, b)| a == b || (**a - **b).abs() <= limit * a.abs().max(1.0)).count();
    same as f64 / a.len() as f64
}

#[test]
fn the_gpu_and_vectors_give_a_plane_the_cost_of_its_patch() {
    let wall = Wall::new();
    let limits = wall.limits();
    let gpu = gpu(&wall.window);
    for (k, size) in [(0, 0.2), (1, 1.0), (2, 5.0)] {
        let matcher = wall.matcher(&limits, &SHIFTS[k..=k], Vec::new());
        let mut start = wall.noise(size, 0.0);
        // The second colour has neighbours that offer something by then.
        start.costs.fill(f32::INFINITY);
        let patch_cost = |at: usize| {
            let (x, y) = (at % WIDTH, at / WIDTH);
            let inside = &wall.searched[0].inside;
            let patch = wall.window.patch(&wall.pictures[0], x, y, |i| inside[i]);
            let cost = patch.cost(&wall.window, [x as f32, y as f32], start.planes[at], &matcher.scales[0].sources[0]);
            ((x + y) % 2 == 0 && inside[at] && patch.variance() >= 40.0).then_some(cost)
        };
        let expected: Vec<_> = (0..WIDTH * HEIGHT).filter_map(|at| Some((at, patch_cost(at)?))).collect();
        assert!(expected.iter().filter(|(_, cost)| *cost < 2.0).count() > 500, "few windows lie in the other photo");
        let mut vectors = start.clone();
        matcher.pass(&mut vectors, AS_IS);
        assert!(expected.iter().all(|(at, cost)| vectors.costs[*at] == *cost));
        let Some(gpu) = &gpu else { continue };
        let mut found = start.clone();
        gpu.passes(&matcher, &mut found, &[AS_IS]).unwrap();
        let off = expected.iter().map(|(at, cost)| (found.costs[*at] - cost).abs()).fold(0.0, f32::max);
        assert!(off < 1e-3, "{off} for planes {size} from the wall");
        // With what neighbours offer, windows that are looked at in the smaller picture, and those that show nothing.
        let same = agree(&vectors.costs, &found.costs, 1e-3);
        assert!(same > 0.99, "{same}");
    }
}

#[test]
fn the_gpu_and_vectors_go_through_passes_as_plain_loops_do() {
    let wall = Wall::new();
    let limits = wall.limits();
    let gpu = gpu(&wall.window);
    let passes = [
        Pass { far: true, step_px: 4.0, restart: true, ..AS_IS },
        Pass { number: 1, step_px: 1.0, ..AS_IS },
        Pass { number: 2, last: true, ..AS_IS },
    ];
    for peers in [Vec::new(), wall.peers()] {
        let matcher = wall.matcher(&limits, &SHIFTS, peers);
        let start = Field::random(&matcher);
        let [mut plain, mut vectors, mut found] = [start.clone(), start.clone(), start];
        passes.iter().for_each(|pass| plain_pass(&matcher, &mut plain, *pass));
        passes.iter().for_each(|pass| matcher.pass(&mut vectors, *pass));
        assert!(plain == vectors, "vectors change what is found");
        let Some(gpu) = &gpu else { continue };
        let mut again = found.clone();
        [&mut found, &mut again].into_iter().for_each(|field| gpu.passes(&matcher, field, &passes).unwrap());
        assert!(found == again, "the GPU gives other bytes the second time");
        let depths = |field: &Field| field.planes.iter().map(|p| p.w).collect::<Vec<_>>();
        let same = [agree(&plain.costs, &found.costs, 1e-3), agree(&depths(&plain), &depths(&found), 1e-3)];
        assert!(same[0] > 0.98 && same[1] > 0.95, "{same:?} of costs and of depths");
        let deviations = [matcher.deviations(&found), gpu.deviations(&matcher, &found).unwrap()];
        let same = agree(&deviations[0], &deviations[1], 1e-2);
        let known = deviations[0].iter().filter(|d| d.is_finite()).count();
        assert!(same > 0.98 && known > 1000, "{same} of {known} deviations");
    }
}
