use drex_core::Pose;

use super::unknowns::JointCoupling;
use super::*;

/// |x − centre|² with the coupling of neighbours, in a box.
struct Bowl {
    unknowns: Unknowns,
    centre: Vec<f64>,
    coupling: f64,
}

impl Bowl {
    fn new(centre: &[f64], coupling: f64, bounds: (f64, f64)) -> Self {
        let n = centre.len();
        let couplings = (0..n).map(|unknown| Some(JointCoupling { unknown, factor: 1.0, offset: 0.0 })).collect();
        let unknowns = Unknowns {
            bounds: vec![bounds; n],
            joints: (0..n).collect(),
            couplings,
            floating: false,
            held: vec![false; n],
        };
        Self { unknowns, centre: centre.to_vec(), coupling }
    }

    fn minimum(&mut self) -> Vec<f64> {
        let mut state = State { base: Pose::identity(), q: vec![0.0; self.centre.len()] };
        Newton::default().minimise(self, &mut state, EXACT, 50);
        state.q
    }
}

impl Problem for Bowl {
    fn unknowns(&self) -> &Unknowns {
        &self.unknowns
    }

    fn value(&mut self, at: &State) -> f64 {
        let far: f64 = at.q.iter().zip(&self.centre).map(|(x, c)| (x - c).powi(2)).sum();
        far + self.coupling * at.q.windows(2).map(|w| w[0] * w[1]).sum::<f64>()
    }

    fn derivatives(&mut self, at: &State, normal: &mut Normal) {
        let n = at.q.len();
        for i in 0..n {
            normal.gradient[i] += 2.0 * (at.q[i] - self.centre[i]);
            normal.add_diagonal(i, 2.0);
            if i + 1 < n {
                normal.gradient[i] += self.coupling * at.q[i + 1];
                normal.gradient[i + 1] += self.coupling * at.q[i];
                normal.add_both(i, i + 1, self.coupling);
            }
        }
    }
}

#[test]
fn the_minimum_in_a_box_meets_its_conditions() {
    for coupling in [-1.5, -0.4, 0.0, 0.9, 1.7] {
        let mut bowl = Bowl::new(&[0.3, 2.0, -1.4, 0.1, 0.9, -0.2], coupling, (-0.5, 0.6));
        let q = bowl.minimum();
        let mut normal = Normal::default();
        normal.reset(q.len());
        bowl.derivatives(&State { base: Pose::identity(), q: q.clone() }, &mut normal);
        for (x, g) in q.iter().zip(&normal.gradient) {
            let met = match *x {
                x if x <= -0.5 => *g >= 0.0,
                x if x >= 0.6 => *g <= 0.0,
                _ => g.abs() < 1e-12,
            };
            assert!(met && (-0.5..=0.6).contains(x), "{coupling}: {x} {g}");
        }
    }
}

#[test]
fn a_saddle_is_left() {
    let mut bowl = Bowl::new(&[1e-3, 0.0], 4.0, (-1.0, 1.0));
    let q = bowl.minimum();
    assert!((q[0] - 1.0).abs() < 1e-12 && (q[1] + 1.0).abs() < 1e-12, "{q:?}");
}

#[test]
fn a_follower_binds_its_leader() {
    let mut robot = drex_robot::Robot::bundled("leap_right").expect("it is bundled");
    robot.joints[3].mimic = Some(drex_robot::Mimic { joint: 2, multiplier: -2.0, offset: 0.5 });
    let unknowns = Unknowns::new(&robot, &vec![true; robot.dof()], false);
    assert_eq!(unknowns.len(), robot.dof() - 1);
    let ((lo, hi), (low, high)) = (unknowns.bounds[2], robot.joints[3].limits.expect("it has limits"));
    let mut q = robot.mid_range();
    for value in [lo, hi] {
        unknowns.set(2, value, &mut q);
        assert!((q[3] - (0.5 - 2.0 * value)).abs() < 1e-12);
        assert!(q[3] >= low - 1e-12 && q[3] <= high + 1e-12);
    }
}
