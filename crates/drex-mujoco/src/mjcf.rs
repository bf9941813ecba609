//! A model, its scene and a state as MJCF.

use drex_diffsim::{Body, BodyState, Material, Model, Part, Scalar, Scene, State};
use nalgebra::Vector3;

use crate::geoms::Masks;
use crate::sections::{Sections, Start, named, value_of};
use crate::text::{Text, list, vector};
use crate::{Error, MjcfOptions, Result, articulation};

/// How much heavier than everything else together a prescribed thing is: forces on it must not show.
const PRESCRIBED_MASS_RATIO: f64 = 1e6;
/// A model, a scene and a state as MJCF text, for `MujocoEngine` or any MuJoCo.
///
/// Bodies are called `body_i`, with their centre of mass as origin; the site `body_i/frame` is the body's own frame.
/// Links are called `arm_i/name` with the names of the robot, and so are joints; geoms `body_i/k`, `arm_i/name/k`,
/// `fixed_i/k` and `mover_i/k`. The key frame `start` has positions, velocities and controls. What follows a path is
/// heavy and without weight, and whoever steps the text has to move it; applied forces are no part of a text.
///
/// # Errors
/// If the model, the scene or the state cannot be simulated, an option is out of range, or something has no counterpart.
pub fn to_mjcf<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &State<T>,
    options: &MjcfOptions,
) -> Result<String> {
    write(model, scene, state, options).map(|w| w.text)
}

/// MJCF, and what of it the engine has to know.
#[derive(Debug)]
#[cfg_attr(not(feature = "engine"), expect(dead_code, reason = "without the engine only the text is used"))]
pub(crate) struct Written {
    pub text: String,
    /// Name, part and index in its collider of every geom.
    pub owners: Vec<(String, Part, u16)>,
    /// Mass of everything that follows a path, kg.
    pub prescribed_kg: f64,
}

pub(crate) fn write<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &State<T>,
    options: &MjcfOptions,
) -> Result<Written> {
    drex_diffsim::check(model, scene, state)?;
    options.check(model.dt_s)?;
    let surfaces = surfaces(model, scene);
    let mut s = Sections::default();
    s.geoms.friction = surfaces.iter().map(|m| m.friction.value()).fold(0.0, f64::max);
    s.prescribed_kg = PRESCRIBED_MASS_RATIO * total_mass_kg(model).max(f64::MIN_POSITIVE);
    let origin = Vector3::zeros();
    for (i, fixed) in scene.static_bodies.iter().enumerate() {
        let name = format!("fixed_{i}");
        s.world.open("body", &named(&name, &fixed.world_from_body));
        let part = (Part::Static(i as u32), &*name);
        s.geoms.write(&mut s.world, part, &fixed.collider, &origin, &fixed.material, Masks::SURROUNDINGS)?;
        s.world.close();
    }
    for (i, mover) in scene.kinematic_bodies.iter().enumerate() {
        let (name, motion) = (format!("mover_{i}"), mover.path.at(state.time_s));
        let mut attributes = named(&name, &motion.pose);
        attributes.push(("gravcomp", "1".into()));
        s.world.open("body", &attributes);
        s.free_joint(&name, &motion.pose, &motion.velocity, &motion.angular_velocity);
        s.prescribed_inertia();
        let part = (Part::Kinematic(i as u32), &*name);
        s.geoms.write(&mut s.world, part, &mover.collider, &origin, &mover.material, Masks::SURROUNDINGS)?;
        s.world.close();
    }
    for (i, (body, b)) in model.bodies.iter().zip(&state.bodies).enumerate() {
        free_body(&mut s, i, body, b)?;
    }
    if model.articulations.len() > Masks::ARTICULATIONS {
        let what =
            format!("{} articulations are more than MuJoCo's collision masks tell apart", model.articulations.len());
        return Err(Error::Unsupported {
            what,
            remedy: format!("simulate at most {} at a time", Masks::ARTICULATIONS),
        });
    }
    for (i, (robot, r)) in model.articulations.iter().zip(&state.articulations).enumerate() {
        let control = scene.controls.get(i).map_or(&[][..], |c| c.at(state.time_s));
        articulation::write(&mut s, i, &robot.map(|x| x.value()), r, control)?;
    }
    let condim = if surfaces.iter().any(|m| m.torsion_radius_m > 0.0) { 4 } else { 3 };
    let mut text = Text::default();
    text.open("mujoco", &[("model", "drex".into())]);
    settings(&mut text, model.dt_s, &scene.gravity.map(|x| x.value()), condim, options);
    text.section("asset", s.geoms.assets);
    text.section("worldbody", s.world);
    text.section("contact", s.contact);
    text.section("actuator", s.actuator);
    let mut key = Text::default();
    let Start { qpos, qvel, ctrl } = &s.start;
    key.leaf("key", &[("name", "start".into()), ("qpos", list(qpos)), ("qvel", list(qvel)), ("ctrl", list(ctrl))]);
    text.section("keyframe", key);
    Ok(Written { text: text.finish(), owners: s.geoms.owners, prescribed_kg: s.prescribed_kg })
}

fn settings(text: &mut Text, model_dt_s: f64, gravity: &Vector3<f64>, condim: u32, options: &MjcfOptions) {
    let dt_s = options.step_s(model_dt_s);
    text.leaf("compiler", &[("angle", "radian".into()), ("autolimits", "true".into())]);
    let attributes = [
        ("timestep", list(&[dt_s])),
        ("gravity", vector(gravity)),
        ("integrator", options.integrator.name().into()),
        ("cone", if options.elliptic { "elliptic" } else { "pyramidal" }.into()),
        ("impratio", list(&[options.impratio])),
        ("noslip_iterations", options.noslip_iterations.to_string()),
        ("solver", "Newton".into()),
        ("iterations", options.iterations.to_string()),
        ("tolerance", list(&[options.tolerance])),
    ];
    text.open("option", &attributes);
    let enabled = |on: bool| if on { "enable" } else { "disable" }.to_owned();
    // A motion that diverges must be seen, not restarted.
    text.leaf("flag", &[("multiccd", enabled(options.multiccd)), ("autoreset", enabled(false))]);
    text.close();
    let reference = list(&[options.contact_s(dt_s), options.damping_ratio]);
    text.open("default", &[]);
    let impedance = list(&options.impedance);
    text.leaf("geom", &[("condim", condim.to_string()), ("solref", reference.clone()), ("solimp", impedance)]);
    text.leaf("joint", &[("solreflimit", reference.clone()), ("solreffriction", reference)]);
    text.close();
}

fn free_body<T: Scalar>(s: &mut Sections, i: usize, body: &Body<T>, state: &BodyState<T>) -> Result<()> {
    let name = format!("body_{i}");
    let mut pose = value_of(&state.world_from_body);
    let com = body.center_of_mass.map(|x| x.value());
    pose.translation.vector = (pose * com).coords;
    s.world.open("body", &named(&name, &pose));
    s.free_joint(&name, &pose, &state.velocity.map(|x| x.value()), &state.angular_velocity.map(|x| x.value()));
    let mass_kg = body.mass_kg.value();
    s.inertial(mass_kg, &Vector3::zeros(), &(body.unit_inertia.map(|x| x.value()) * mass_kg));
    s.world.leaf("site", &[("name", format!("{name}/frame")), ("pos", vector(&-com.coords))]);
    let part = (Part::Body(i as u32), &*name);
    s.geoms.write(&mut s.world, part, &body.collider, &-com.coords, &body.material, Masks::BODY)?;
    s.world.close();
    Ok(())
}

fn total_mass_kg<T: Scalar>(model: &Model<T>) -> f64 {
    let links = model.articulations.iter().flat_map(|a| &a.links).map(|l| l.mass_kg.value());
    model.bodies.iter().map(|b| b.mass_kg.value()).chain(links).sum()
}

fn surfaces<'a, T: Scalar>(model: &'a Model<T>, scene: &'a Scene<T>) -> Vec<&'a Material<T>> {
    let surroundings =
        scene.static_bodies.iter().map(|f| &f.material).chain(scene.kinematic_bodies.iter().map(|m| &m.material));
    let moving = model.bodies.iter().map(|b| &b.material).chain(model.articulations.iter().flat_map(|a| &a.materials));
    surroundings.chain(moving).collect()
}
