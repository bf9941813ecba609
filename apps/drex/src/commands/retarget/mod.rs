//! `drex retarget`: a person's hand on a robot hand, frame by frame, over a clip with its object, or from a stream.

mod clip;
mod file;
mod grasp;
mod stream;

use std::path::Path;

use anyhow::{Context, Result, bail};
use drex_core::mesh::convex_hull;
use drex_core::{Pose, pose};
use drex_demo::{Demonstration, LoadOptions, RegisterOptions, Side, read_point_frames};
use drex_mesh::{MeshSdf, metric_mesh};
use drex_retarget::{RetargetOptions, TargetHand};
use nalgebra::{Unit, Vector3};

use crate::cli::{ObjectiveArg, ReadingArgs, RetargetArgs};
use crate::ui::Ui;
use drex_twin::lock::digest_of;

/// Runs the subcommand.
pub fn run(args: &RetargetArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    if args.demo.as_os_str() == "-" {
        return stream::run(args, ui);
    }
    if args.out.is_none() && args.picture.is_none() {
        bail!("there is nothing to write: give --out FILE (JSON), --picture FILE (PNG), or both");
    }
    if let Some(picture) =
        args.picture.as_ref().filter(|p| !p.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")))
    {
        bail!("--picture {}: pictures are PNG; give a name that ends in .png", picture.display());
    }
    let mut demo = Demonstration::load(&args.demo, &load_options(&args.reading))?;
    let hand = hand(args, demo.side, ui)?;
    let object = args.object.as_ref().map(|path| Object::load(path, args, ui)).transpose()?;
    if let (Some(folder), Some(object)) = (&args.object_points, &object) {
        let points = read_point_frames(folder)?;
        demo.register_object(&points, &object.solid, &RegisterOptions::default())?;
    }
    demo.notes.iter().for_each(|note| ui.note(format!("  note     {note}")));
    match args.objective {
        ObjectiveArg::Grasp => {
            let object = object.context("the grasp objective needs the object: give --object MESH")?;
            grasp::run(args, &demo, &hand, &object, seed, ui)
        }
        _ if args.augment.is_some() => {
            bail!("--augment makes grasps, which only the grasp objective knows: add --objective grasp --object MESH")
        }
        _ => clip::run(args, &demo, &hand, object.as_ref(), ui),
    }
}

/// How a demonstration is read, from the command line.
pub fn load_options(args: &ReadingArgs) -> LoadOptions {
    let mut options = LoadOptions::default();
    options.side = args.side.map(Into::into);
    options.mirrored = args.mirrored;
    options.unit = args.demo_unit.map(Into::into);
    options.order = args.order.into();
    options.fps = args.fps;
    (options.first_frame, options.last_frame) = args.frames.map_or((None, None), |[a, b]| (Some(a), Some(b)));
    options.object_poses.clone_from(&args.object_poses);
    options.mano_model.clone_from(&args.mano_model);
    options.mano_flat_hand = args.mano_flat_hand;
    options.focal_px = args.focal;
    options
}

/// The hand that is asked for, mirrored if the person's is the other one.
fn hand(args: &RetargetArgs, side: Side, ui: &Ui) -> Result<TargetHand> {
    let hand = match &args.mapping {
        Some(mapping) if Path::new(&args.hand).is_file() => TargetHand::load(Path::new(&args.hand), Some(mapping))?,
        Some(mapping) => {
            let robot = TargetHand::resolve(&args.hand)?.robot;
            TargetHand::with_mapping(robot, mapping, &drex_core::fsutil::read_text(mapping)?)?
        }
        None => TargetHand::resolve(&args.hand)?,
    };
    hand.notes.iter().for_each(|note| ui.note(format!("  note     {note}")));
    if hand.side == side {
        return Ok(hand);
    }
    ui.note(format!("  note     a {side} hand: the mirror image of {} is used", args.hand));
    Ok(hand.mirrored())
}

/// Options of the plain objectives.
fn options(args: &RetargetArgs) -> RetargetOptions {
    let mut options = RetargetOptions::new(args.objective.into());
    if let Some(scale) = args.scale {
        options.scale = scale.0;
    }
    if let Some(alpha) = args.low_pass {
        options.low_pass_alpha = alpha;
    }
    options
}

/// The object of a demonstration.
struct Object {
    mesh: drex_core::TriMesh,
    solid: MeshSdf,
    sha256: String,
}

impl Object {
    /// The mesh of the command line, closed and in metres, or its convex hull.
    fn load(path: &Path, args: &RetargetArgs, ui: &Ui) -> Result<Self> {
        let (mut mesh, notes) = metric_mesh(path, args.unit)?;
        notes.iter().for_each(|note| ui.note(format!("  note     {note}")));
        if args.object_hull {
            mesh = convex_hull(&mesh.vertices)?;
        }
        let solid = MeshSdf::new(&mesh)?;
        let sha256 = digest_of(&drex_core::fsutil::read_bytes(path)?);
        Ok(Self { mesh, solid, sha256 })
    }
}

/// Up in the frame of the recording: what the command line or the file says, else the object's z axis in the first frame that
/// has the object's pose.
fn up(args: &RetargetArgs, demo: &Demonstration, ui: &Ui) -> Option<Unit<Vector3<f64>>> {
    if let Some(up) = args.up {
        return Unit::try_new(Vector3::from(up), 1e-9);
    }
    demo.up.or_else(|| {
        let pose = demo.frames.iter().find_map(|f| f.source_from_object)?;
        ui.note(
            "  note     the recording does not say where up is: the object's z axis in its first frame is taken (--up)",
        );
        Some(pose.rotation * Vector3::z_axis())
    })
}

/// The pose that makes `up` vertical, for pictures; half a turn about x, as for a camera, where nobody knows it.
fn upright(up: Option<Unit<Vector3<f64>>>) -> Pose {
    let turn = pose::upright(&up.unwrap_or(-Vector3::z_axis()));
    Pose::from_parts(nalgebra::Translation3::identity(), turn)
}
