//! What `drex --help` shows: the subcommands in groups, and examples for each. The tests run every example through the parser.

use std::fmt::Write;

use clap::builder::StyledStr;
use clap::{Command, CommandFactory};

use super::Cli;

/// Headings of `drex --help` and the subcommands below them.
const GROUPS: [(&str, &[&str]); 6] = [
    ("All of it", &["demo", "run", "report", "batch", "import"]),
    ("The object", &["sfm", "masks", "reconstruct", "asset", "mesh", "render"]),
    ("Its mass", &["identify", "plan-push", "calibrate-hand"]),
    ("People's hands", &["hands", "retarget"]),
    ("The grasp", &["train", "evaluate", "grasp", "deploy", "hw"]),
    ("This program", &["doctor", "completions", "man", "help"]),
];

/// Lines behind the help of a subcommand; words of a subcommand's name are separated by blanks.
const EXAMPLES: [(&str, &str); 32] = [
    (
        "sfm",
        "drex sfm photos --out cameras
  drex sfm photos --out cameras --marker tag36h11:11:0.06    tag 11, its black border 60 mm wide, lies beside the object
  drex sfm turntable --out cameras --masks turntable/masks    what turns is white
  drex sfm clip.mp4 --out cameras --camera K.txt",
    ),
    (
        "masks",
        "drex masks photos --out twin
  drex masks photos --out twin --object 512,300@IMG_1001.jpg    this one of several things",
    ),
    (
        "reconstruct",
        "drex reconstruct scan --out twin --hold-out 8     a folder of photos, with or without their cameras
  drex reconstruct clip.mp4 --out twin --preset fast",
    ),
    (
        "asset",
        "drex asset scan.stl --out twin --mass 0.21
  drex asset photos --out twin --marker tag36h11:11:0.06    photos alone; a printed tag beside the object gives the scale
  drex asset scan --out twin --distance A-C=0.12    photos, with the pixels of marks A and C in scan/marks.json
  drex asset recording --out twin --poses recording/ob_in_cam",
    ),
    ("mesh check", "drex mesh check twin    a folder that drex asset wrote, or any mesh file"),
    ("mesh convert", "drex mesh convert scan.ply scan.glb --faces 5000"),
    ("mesh picture", "drex mesh picture twin/mesh/visual.obj --out look.png"),
    (
        "identify",
        "drex identify push/tilt
  drex identify push/tilt --free friction --prior contact_height=0,0.005
  drex identify push/ketchup1 --hand hand.json --out result.json",
    ),
    ("plan-push", "drex plan-push scan.stl --masses 0.05,0.5 --max-force 10"),
    ("calibrate-hand", "drex calibrate-hand pushes --out hand.json"),
    (
        "render",
        "drex render twin/splat/appearance.ply --out frames --orbit 60
  drex render scene.ply --out frames --object tin.ply --trajectory poses.csv",
    ),
    (
        "hands",
        "drex hands clip.mp4 --out demo.json
  drex hands clip.mp4 --out demo.json --detector command --format npz -- my_detector {video} {out}",
    ),
    (
        "retarget",
        "drex retarget demo.json --hand leap --out out.json
  drex retarget demo.json --hand leap --objective grasp --object scan.obj --out out.json --picture out.png
  drex retarget hands.npz --focal 1080 --object-poses ob_in_cam --hand allegro --out out.json",
    ),
    ("train", "drex train twin"),
    ("evaluate", "drex evaluate twin"),
    (
        "grasp",
        "drex grasp twin
  drex grasp twin --pose 0.4,0,0,1,0,0,0 --mass 0.3
  drex grasp twin/policy/network --mesh scan.obj --mass 0.3",
    ),
    (
        "deploy",
        "drex deploy twin --emulate
  drex deploy twin --port /dev/ttyUSB0 --law law.json --hold 5 --log grasp.csv",
    ),
    ("hw ping", "drex hw ping --hand leap --port /dev/ttyUSB0"),
    ("hw status", "drex hw status --hand leap --port /dev/ttyUSB0"),
    (
        "hw move",
        "drex hw move --hand leap --port /dev/ttyUSB0 --cap 150 --to rest --seconds 3
  drex hw move --hand leap --port /dev/ttyUSB0 --to if_mcp=0.5,th_cmc=0.2",
    ),
    (
        "hw record",
        "drex hw record --hand leap --port /dev/ttyUSB0 --seconds 20 --out log.csv
  drex hw record --hand leap --port /dev/ttyUSB0 --play log.csv --out again.csv",
    ),
    (
        "hw calibrate",
        "drex hw calibrate pairs.csv --lever 0.06 --source \"scale under the index fingertip\" --date 2026-11-21",
    ),
    ("hw emulate", "drex hw emulate leap --link leap --wall if_mcp=0.6"),
    ("run", "drex run twin"),
    (
        "batch",
        "drex batch twins                                     every twin in a folder
  drex batch twins --stages identify,trial --jobs 4
  drex batch objects.toml --shard 0/4                 the first of four parts, on a machine of its own",
    ),
    ("batch merge", "drex batch merge objects.toml"),
    ("batch report", "drex batch report twins"),
    ("import d-rex", "drex import d-rex recordings --out twins --object cookie"),
    ("import allegro-run", "drex import allegro-run recordings/runs/ketchup1 --out push/ketchup1"),
    ("import mujoco-push", "drex import mujoco-push push_mujoco/brick/lift_force --poses clean --out push/lift"),
    (
        "completions",
        "drex completions bash  > ~/.local/share/bash-completion/completions/drex
  drex completions zsh   > ~/.zfunc/_drex    with fpath+=~/.zfunc before compinit in ~/.zshrc
  drex completions fish  > ~/.config/fish/completions/drex.fish",
    ),
    ("man", "drex man --out ~/.local/share/man/man1"),
];

/// The command line with its groups and examples.
pub fn command() -> Command {
    let mut command = Cli::command();
    for (path, examples) in EXAMPLES {
        command = with_examples(command, path, examples);
    }
    let groups = groups(&command);
    command.help_template(groups)
}

/// Adds the examples to the subcommand at `path`.
fn with_examples(command: Command, path: &str, examples: &'static str) -> Command {
    match path.split_once(' ') {
        Some((first, rest)) => command.mut_subcommand(first, |c| with_examples(c, rest, examples)),
        None => command.mut_subcommand(path, |c| {
            let header = *c.get_styles().get_header();
            c.after_help(StyledStr::from(format!("{header}Examples:{header:#}\n  {examples}")))
        }),
    }
}

/// The help of `drex` itself: subcommands by groups; those that no group names come last.
fn groups(command: &Command) -> StyledStr {
    let styles = command.get_styles();
    let (header, literal) = (*styles.get_header(), *styles.get_literal());
    let about = |name: &str| match command.find_subcommand(name).and_then(Command::get_about) {
        Some(about) => about.to_string(),
        None => "Print this help, or that of a subcommand".to_owned(),
    };
    let width = command.get_subcommands().map(|c| c.get_name().len()).max().unwrap_or(0);
    let ungrouped: Vec<&str> = command
        .get_subcommands()
        .map(Command::get_name)
        .filter(|name| !GROUPS.iter().any(|(_, names)| names.contains(name)))
        .collect();
    let mut text = "{about-with-newline}\n{usage-heading} {usage}\n".to_owned();
    for (title, names) in GROUPS.into_iter().chain([("More", ungrouped.as_slice())]).filter(|(_, n)| !n.is_empty()) {
        // Writing to a String cannot fail.
        let _ = write!(text, "\n{header}{title}:{header:#}\n");
        for name in names {
            let _ = writeln!(text, "  {literal}{name:width$}{literal:#}  {}", about(name));
        }
    }
    StyledStr::from(text + &format!("\n{header}Options:{header:#}\n{{options}}{{after-help}}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_subcommand_has_a_group() {
        assert!(!groups(&Cli::command()).to_string().contains("More:"));
        let known: Vec<String> = Cli::command().get_subcommands().map(|c| c.get_name().to_owned()).collect();
        for name in GROUPS.iter().flat_map(|(_, names)| names.iter()).filter(|n| **n != "help") {
            assert!(known.iter().any(|k| k == name), "there is no {name}");
        }
    }

    #[test]
    fn every_example_is_understood() {
        for (path, examples) in EXAMPLES {
            for line in examples.lines() {
                // Two blanks begin a remark.
                let call = line.trim().split("  ").next().unwrap_or_default();
                assert!(call.starts_with(&format!("drex {path} ")), "{call} is no example of {path}");
                let words = call.split('"').enumerate().flat_map(|(i, part)| match i % 2 {
                    0 => part.split_whitespace().collect::<Vec<_>>(),
                    _ => vec![part],
                });
                if let Err(error) = command().try_get_matches_from(words) {
                    panic!("{call}: {error}");
                }
            }
        }
    }

    #[test]
    fn the_definition_is_consistent() {
        command().debug_assert();
    }

    #[test]
    fn every_subcommand_and_option_says_what_it_is() {
        fn look(command: &Command, path: &str) {
            for sub in command.get_subcommands().filter(|c| c.get_name() != "help") {
                let path = format!("{path} {}", sub.get_name());
                let about = sub.get_about().map(ToString::to_string).unwrap_or_default();
                assert!(!about.is_empty() && about.lines().count() == 1, "{path}: {about:?}");
                for argument in sub.get_arguments() {
                    assert!(argument.get_help().is_some(), "{path}: {} says nothing", argument.get_id());
                }
                look(sub, &path);
            }
        }
        look(&command(), "drex");
    }
}
