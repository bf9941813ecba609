//! The equations of a topple, and what in them is known to within an error.
//!
//! g r + J θ̈ = M / m is weighed with the hat function of each frame (one there, zero at its neighbours), which turns θ̈ into the
//! difference of the slopes of θ before and after the frame: no derivative is estimated. The noise of the leans then is alike
//! in neighbouring equations; its covariance is carried along. Frames after the touch have M = 0: they tell nothing about the mass
//! but where the edge is, because the object falls about it.

use nalgebra::{Cholesky, DMatrix, DVector, Vector3};

use super::moments::Samples;
use super::{BoundOptions, Topple};

/// Time over which errors of an effort are alike, s.
const ALIKE: f64 = 0.05;
/// Share of m g r that a rigid body that turns about a fixed edge misses (it slides, it rolls over a rounded edge).
const MODEL: f64 = 0.15;

/// Something known to within an error, in standard deviations u from its most likely value.
pub(super) struct Unknown {
    pub name: String,
    pub mean: f64,
    pub sd: f64,
    /// What stays positive together with the value: value + this = (mean + this) exp(u sd / (mean + this)). `None`: mean + u sd.
    positive_with: Option<f64>,
    /// Whether it belongs to the efforts themselves.
    pub effort: bool,
}

impl Unknown {
    fn value(&self, u: f64) -> f64 {
        match self.positive_with {
            Some(shift) if self.mean + shift > 0.0 => {
                let whole = self.mean + shift;
                whole * (u * self.sd / whole).clamp(-5.0, 5.0).exp() - shift
            }
            _ => self.mean + u * self.sd,
        }
    }
}

/// Unknowns that are the same in every topple of one object by one hand.
pub(super) const COMMON: [&str; 4] =
    ["load factor and link masses", "edge of the foot", "height of the centre of mass", "friction of the tip"];

/// Places of the unknowns; the offsets of the fingers come last.
const SCALE: usize = 0;
const HEIGHT: usize = 1;
const CLOCK: usize = 2;
const FOOT: usize = 3;
const DENSITY: usize = 4;
const FRICTION: usize = 5;
const LEAN: usize = 6;
const OFFSETS: usize = 7;

pub(super) struct Scene<'a> {
    pub samples: &'a Samples,
    gravity: f64,
    /// Height of the centre of mass, m.
    center: f64,
    /// From the centre of mass back to the face that is pushed, m.
    behind: f64,
    /// Inertia per mass about a horizontal axis through the centre of mass, m².
    inertia: f64,
    /// Quantities known to within an error.
    pub unknowns: Vec<Unknown>,
}

/// One equation: ∫ hat (g r + J θ̈) dt = ∫ hat M dt / m.
pub(super) struct Row {
    pub moment: f64,
    pub per_mass: f64,
}

impl<'a> Scene<'a> {
    pub fn of(run: &Topple<'_>, samples: &'a Samples, options: &BoundOptions) -> Option<Self> {
        let solid = run.solid;
        let up = solid.firm(&run.found.up_in_mesh);
        let towards = run.found.tracked_from_mesh.rotation.inverse() * run.found.topples_towards_in_tracked?;
        let com = solid.unit.center_of_mass.coords;
        let size = solid.size_m();
        let reach = |rise: f64| solid.foot_reach(&up, &towards, rise * size);
        let axis = up.cross(&towards).try_normalize(1e-9).unwrap_or_else(Vector3::y);
        let scale_sd = samples.pushers.iter().map(|p| p.scale_sd).fold(0.0, f64::max);
        let unknown = |name: &str, mean: f64, sd: f64, positive_with: Option<f64>| Unknown {
            name: name.into(),
            mean,
            sd,
            positive_with,
            effort: false,
        };
        let foot = reach(0.01);
        let foot_sd = (0.5 * (reach(0.03) - reach(0.003))).hypot(options.foot_sd * foot);
        let heights = samples.pushers.iter().map(|p| p.height_m[p.index(p.touch_s[0])]);
        let tip = heights.fold(f64::INFINITY, f64::min);
        let mut unknowns = vec![
            unknown(COMMON[0], 1.0, scale_sd, Some(0.0)),
            unknown("height of the hand", samples.height_m[0], samples.height_m[1], Some(tip)),
            unknown("clock of the tracker", samples.clock_s[0], samples.clock_s[1], None),
            unknown(COMMON[1], foot, foot_sd, Some(0.0)),
            unknown(COMMON[2], 1.0, options.density_sd, Some(0.0)),
            unknown(COMMON[3], 0.0, options.tip_friction_sd, None),
            unknown("tracked lean", 1.0, options.lean_sd, Some(0.0)),
        ];
        debug_assert_eq!(unknowns.len(), OFFSETS);
        for p in &samples.pushers {
            let offset = unknown(&format!("joint friction of {}", p.name), 0.0, p.offset_sd_nm, None);
            unknowns.push(Unknown { effort: true, ..offset });
        }
        Some(Self {
            samples,
            gravity: run.gravity_m_s2,
            center: up.dot(&com) - solid.lowest(&up),
            behind: solid.hull.vertices.iter().map(|v| -towards.dot(&(v.coords - com))).fold(0.0, f64::max),
            inertia: axis.dot(&(solid.unit.inertia * axis)) / solid.unit.mass_kg,
            unknowns,
        })
    }

    /// Number of equations.
    pub fn equations(&self) -> usize {
        self.samples.frames.len().saturating_sub(2)
    }

    /// Covariance of the equations at `per_kg`, with variances `added`.
    pub fn covariance_with(&self, per_kg: f64, u: &[f64], added: &[f64]) -> DMatrix<f64> {
        self.covariance(per_kg, &self.values(u)) + DMatrix::from_diagonal(&DVector::from_column_slice(added))
    }

    pub fn values(&self, u: &[f64]) -> Vec<f64> {
        self.unknowns.iter().zip(u).map(|(k, u)| k.value(*u)).collect()
    }

    /// Moment of all fingertips about the edge at time `t` of the joint log, N m.
    fn moment(&self, v: &[f64], t: f64) -> f64 {
        let mut moment = 0.0;
        for (n, p) in self.samples.pushers.iter().enumerate().filter(|(_, p)| p.touches(t)) {
            let k = p.index(t);
            // Friction along the face loads the joint, too.
            let torque = v[SCALE] * p.force_n[k] + p.per_offset[k] * v[OFFSETS + n];
            let force = torque / (1.0 + v[FRICTION] * p.friction_lever[k]);
            moment += force * (p.height_m[k] + v[HEIGHT] + v[FRICTION] * (v[FOOT] + self.behind));
        }
        moment
    }

    pub fn impulse(&self, v: &[f64]) -> f64 {
        let all = self.samples.pushers.iter().flat_map(|p| p.touch_s);
        let (first, last) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
        let steps = ((last - first) / 0.01).max(0.0) as usize;
        (0..=steps).map(|k| 0.01 * self.moment(v, first + 0.01 * k as f64)).sum()
    }

    /// Way to the edge and inertia about it.
    fn arm(&self, v: &[f64], lean: f64) -> f64 {
        self.gravity * (v[FOOT] * lean.cos() - self.center * v[DENSITY] * lean.sin())
    }

    fn about_edge(&self, v: &[f64]) -> f64 {
        self.inertia + v[FOOT].powi(2) + (self.center * v[DENSITY]).powi(2)
    }

    pub fn rows(&self, v: &[f64]) -> Vec<Row> {
        let f = &self.samples.frames;
        let row = |i: usize| {
            let [(t0, a), (t1, b), (t2, c)] = [f[i - 1], f[i], f[i + 1]].map(|(t, lean)| (t, lean * v[LEAN]));
            let (h, k) = (t1 - t0, t2 - t1);
            // Exact for arms that are linear between frames.
            let arms = self.arm(v, a) * h / 6.0 + self.arm(v, b) * (h + k) / 3.0 + self.arm(v, c) * k / 6.0;
            let per_mass = arms + self.about_edge(v) * ((c - b) / k - (b - a) / h);
            let parts = 8;
            let hat = |from: f64, length: f64, rising: bool| -> f64 {
                (0..parts)
                    .map(|n| {
                        let s = (f64::from(n) + 0.5) / f64::from(parts);
                        let weight = if rising { s } else { 1.0 - s };
                        weight * self.moment(v, from + s * length - v[CLOCK]) * length / f64::from(parts)
                    })
                    .sum()
            };
            Row { moment: hat(t0, h, true) + hat(t1, k, false), per_mass }
        };
        (1..f.len() - 1).map(row).collect()
    }

    /// What the moment misses of knocks, weighed with the hat over three frames, N m s.
    fn knock(&self, v: &[f64], [a, b, c]: [f64; 3]) -> f64 {
        let mut sum = 0.0;
        for p in &self.samples.pushers {
            for ((t, knock), h) in p.times_s.iter().zip(&p.knock_n).zip(&p.height_m) {
                let t = t + v[CLOCK];
                let hat = if t < b { (t - a) / (b - a) } else { (c - t) / (c - b) };
                sum += hat.max(0.0) * knock * (h + v[HEIGHT]).abs() * 0.01;
            }
        }
        sum
    }

    /// Covariance of the equations at `per_kg`.
    fn covariance(&self, per_kg: f64, v: &[f64]) -> DMatrix<f64> {
        let f = &self.samples.frames;
        let n = f.len() - 2;
        let mut slopes = DMatrix::zeros(n, n + 2);
        let mut c = DMatrix::zeros(n, n);
        for i in 0..n {
            let (h, k) = (f[i + 1].0 - f[i].0, f[i + 2].0 - f[i + 1].0);
            slopes[(i, i)] = 1.0 / h;
            slopes[(i, i + 1)] = -1.0 / h - 1.0 / k;
            slopes[(i, i + 2)] = 1.0 / k;
            c[(i, i)] += (per_kg * self.knock(v, [f[i].0, f[i + 1].0, f[i + 2].0])).powi(2);
            let t = f[i + 1].0 - v[CLOCK];
            let touching = self.samples.pushers.iter().filter(|p| p.touches(t));
            let moment: f64 = touching.map(|p| (p.noise_n * (p.height_m[p.index(t)] + v[HEIGHT])).powi(2)).sum();
            // A white noise over the square of the hat, a third of its base.
            c[(i, i)] += per_kg * per_kg * moment * ALIKE * (h + k) / 3.0;
            let miss = MODEL * self.gravity * v[FOOT].hypot(self.center * f[i + 1].1.sin()) * 0.5 * (h + k);
            c[(i, i)] += miss * miss;
            if i == 0 {
                // The object leaves the table somewhere between the first two frames; until then the table bears part of it.
                c[(i, i)] += (self.gravity * v[FOOT] * 0.5 * h).powi(2) / 3.0;
            }
        }
        let scale = self.about_edge(v) * self.samples.lean_noise;
        c + &slopes * slopes.transpose() * (scale * scale)
    }

    /// Updates the variance added to each equation so that none misses by more than two standard deviations of its own.
    pub fn forgive(&self, per_kg: f64, u: &[f64], added: &mut [f64]) -> Option<()> {
        let v = self.values(u);
        let own = self.covariance(per_kg, &v);
        for (i, row) in self.rows(&v).iter().enumerate() {
            added[i] = ((row.per_mass - per_kg * row.moment).powi(2) / 4.0 - own[(i, i)]).max(0.0);
        }
        Some(())
    }

    /// Jacobian by central differences, and residual, both whitened; priors as rows of their own.
    pub fn linearised(&self, per_kg: f64, u: &[f64], added: &[f64]) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let now = self.values(u);
        let factor = Cholesky::new(self.covariance_with(per_kg, u, added))?;
        let white = |v: &[f64], per_kg: f64| -> Option<DVector<f64>> {
            let rows = self.rows(v);
            let r = rows.iter().map(|r| r.per_mass - per_kg * r.moment);
            factor.l_dirty().solve_lower_triangular(&DVector::from_iterator(rows.len(), r))
        };
        let here = white(&now, per_kg)?;
        let (rows, n) = (here.len(), u.len());
        let mut jacobian = DMatrix::zeros(rows + n, n + 1);
        let mut r = DVector::zeros(rows + n);
        jacobian.view_mut((0, 0), (rows, 1)).copy_from(&(white(&now, per_kg + 1.0)? - &here));
        r.rows_mut(0, rows).copy_from(&here);
        for i in 0..n {
            const H: f64 = 0.1;
            let moved = |s: f64| {
                let mut u = u.to_vec();
                u[i] += s * H;
                white(&self.values(&u), per_kg)
            };
            let slope = (moved(1.0)? - moved(-1.0)?) / (2.0 * H);
            jacobian.view_mut((0, i + 1), (rows, 1)).copy_from(&slope);
            jacobian[(rows + i, i + 1)] = 1.0;
            r[rows + i] = u[i];
        }
        Some((jacobian, r))
    }
}
