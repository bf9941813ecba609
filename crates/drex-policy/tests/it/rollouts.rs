//! The second phase, with a made-up simulator whose answers are known.
#![cfg(feature = "flex")]

use crate::common::{FRICTION, box_points, small, toy};
use drex_policy::{
    Error, Feedback, GRAVITY_M_S2, PredictedGrasp, Query, Result, RolloutOptions, Rollouts, TrainOptions, Trainer,
};

const MASSES: [f64; 3] = [0.1, 0.2, 0.4];

/// The first way (palm above the object) never holds; the second needs four times the weight and is touched by the second finger alone,
/// against what the demonstrations say (3.5 times, the first finger alone).
struct MadeUp;

const NEEDED: f64 = 4.0;

impl Rollouts for MadeUp {
    fn rollout(&self, object: usize, grasp: &PredictedGrasp, mass_kg: f64, friction: f64, _: u64) -> Result<Feedback> {
        assert!(object == 0 && friction == FRICTION && (0.1..=0.4).contains(&mass_kg));
        if first_way(grasp) {
            return Ok(Feedback {
                fingers_in_contact: vec![true, false],
                retained: 0.1,
                held: false,
                friction_used: None,
                needed_grip_force_n: None,
            });
        }
        let used = NEEDED * mass_kg * GRAVITY_M_S2 / grasp.grip_force_n;
        Ok(Feedback {
            fingers_in_contact: vec![false, true],
            retained: if used <= 1.0 { 1.0 } else { 0.6 },
            held: used <= 1.0,
            friction_used: Some(used.min(1.0)),
            needed_grip_force_n: None,
        })
    }
}

fn first_way(grasp: &PredictedGrasp) -> bool {
    grasp.object_from_base.translation.z > 0.08
}

fn options() -> TrainOptions {
    small().with_rollouts(RolloutOptions::default().with_epochs(40))
}

fn learned<'a>(data: &'a drex_policy::Dataset, options: &TrainOptions) -> Trainer<'a> {
    let mut trainer = Trainer::new(data, options).unwrap();
    while trainer.learn().unwrap().is_some() {}
    trainer
}

#[test]
fn logits_contacts_and_grip_forces_learn_and_poses_stay() {
    let data = toy(24, &MASSES);
    let mut trainer = learned(&data, &options());
    let points = box_points();
    let ask = |t: &Trainer<'_>, mass| t.policy().predict(&Query::new(&points, mass, FRICTION)).unwrap();
    let weight_of_first = |g: &[PredictedGrasp]| g.iter().filter(|g| first_way(g)).map(|g| g.weight).sum::<f64>();
    let before = ask(&trainer, 0.2);
    assert!(weight_of_first(&before) > 0.5, "two of three demonstrations are of the first way");
    while trainer.roll_out(&MadeUp).unwrap().is_some() {}
    let curve = trainer.rollouts().to_vec();
    let (first, last) = (curve[0], curve[curve.len() - 1]);
    assert_eq!(curve.len(), 40);
    assert!(last.policy_reward > 0.8 && last.policy_reward > first.policy_reward + 0.2, "{first:?} {last:?}");
    assert!(last.held >= 0.4 && last.held > first.held, "half the tries are of the hopeless way");
    assert!(last.force_gap < 0.1 && last.contact_loss < 0.2, "{last:?}");
    for mass in [0.1, 0.15, 0.2, 0.4] {
        let after = ask(&trainer, mass);
        assert!(weight_of_first(&after) < 0.1, "{}", weight_of_first(&after));
        let second = after.iter().find(|g| !first_way(g)).unwrap();
        // The cone is to be used by 0.7.
        let wanted = NEEDED * mass * GRAVITY_M_S2 / 0.7;
        assert!(
            (second.grip_force_n / wanted - 1.0).abs() < 0.05,
            "{mass} kg: {} N for {wanted} N",
            second.grip_force_n
        );
        assert!(second.contacts[0] < 0.1 && second.contacts[1] > 0.9, "{:?}", second.contacts);
    }
    // Poses stay although everything else moved.
    assert!(last.joint_drift_rad < 0.01 && last.wrist_drift_m < 0.001, "{last:?}");
    let (_, report) = trainer.finish().unwrap();
    assert_eq!(report.rollouts, curve);
    let csv = report.curve_csv();
    assert_eq!(csv.lines().count(), 1 + report.curve.len() + 2 + 40);
    assert_eq!(csv.lines().next().unwrap().split(',').count(), csv.lines().nth(5).unwrap().split(',').count());
    assert_eq!(csv.lines().last().unwrap().split(',').count(), 9);
    assert!(report.curve_svg().starts_with("<svg") && report.curve_svg().matches("<path").count() == 4);
}

/// The first way carries what is light, the second what is heavy.
struct ByMass;

impl Rollouts for ByMass {
    fn rollout(&self, _: usize, grasp: &PredictedGrasp, mass_kg: f64, _: f64, _: u64) -> Result<Feedback> {
        let held = first_way(grasp) == (mass_kg < 0.2);
        Ok(Feedback {
            fingers_in_contact: vec![true, true],
            retained: f64::from(u8::from(held)),
            held,
            friction_used: None,
            needed_grip_force_n: None,
        })
    }
}

#[test]
fn the_grasp_that_is_proposed_changes_with_the_mass() {
    let data = toy(24, &MASSES);
    let mut trainer = learned(&data, &options());
    while trainer.roll_out(&ByMass).unwrap().is_some() {}
    let points = box_points();
    for (mass_kg, first) in [(0.11, true), (0.14, true), (0.28, false), (0.38, false)] {
        let grasps = trainer.policy().predict(&Query::new(&points, mass_kg, FRICTION)).unwrap();
        assert!(first_way(&grasps[0]) == first && grasps[0].weight > 0.8, "{mass_kg} kg: {:.2}", grasps[0].weight);
    }
}

#[test]
fn without_the_anchor_poses_drift_more() {
    let data = toy(24, &MASSES);
    let drift = |anchor_weight: f64| {
        let mut rollouts = RolloutOptions::default().with_epochs(15);
        (rollouts.anchor_weight, rollouts.demo_weight) = (anchor_weight, 0.0);
        let mut trainer = learned(&data, &small().with_rollouts(rollouts));
        while trainer.roll_out(&MadeUp).unwrap().is_some() {}
        trainer.rollouts().last().unwrap().joint_drift_rad
    };
    let (free, held) = (drift(0.0), drift(1.0));
    assert!(free > 3.0 * held, "{free} rad against {held} rad");
}

struct Broken(fn(&mut Feedback));

impl Rollouts for Broken {
    fn rollout(
        &self,
        object: usize,
        grasp: &PredictedGrasp,
        mass_kg: f64,
        friction: f64,
        seed: u64,
    ) -> Result<Feedback> {
        let mut feedback = MadeUp.rollout(object, grasp, mass_kg, friction, seed)?;
        (self.0)(&mut feedback);
        Ok(feedback)
    }
}

struct Refusing;

impl Rollouts for Refusing {
    fn rollout(&self, _: usize, _: &PredictedGrasp, mass_kg: f64, friction: f64, _: u64) -> Result<Feedback> {
        let what = "the simulator is on strike".to_owned();
        Err(Error::Rollout { object: "box".into(), mass_kg, friction, what, remedy: "wait".into() })
    }
}

#[test]
fn feedback_that_cannot_be_used_is_named_and_teaches_nothing() {
    let data = toy(6, &MASSES);
    let mut trainer = learned(&data, &options().with_epochs(2));
    let before = trainer.policy().clone();
    let says = |t: &mut Trainer<'_>, rollouts: &dyn Rollouts, word: &str| {
        let message = t.roll_out(rollouts).unwrap_err().to_string();
        assert!(message.contains("'box'") && message.contains(word), "{message}");
    };
    says(&mut trainer, &Broken(|f| f.fingers_in_contact.clear()), "0 contacts for 2 fingers");
    says(&mut trainer, &Broken(|f| f.retained = f64::NAN), "retained is NaN");
    says(&mut trainer, &Broken(|f| f.friction_used = Some(-1.0)), "friction_used");
    says(&mut trainer, &Broken(|f| f.needed_grip_force_n = Some(f64::INFINITY)), "needed_grip_force_n");
    says(&mut trainer, &Refusing, "on strike");
    assert_eq!(trainer.policy(), &before);
    assert!(trainer.roll_out(&MadeUp).unwrap().is_some());
}
