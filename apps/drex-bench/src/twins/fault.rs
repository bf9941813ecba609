//! What is wrong with a broken twin.

/// A fault of the kind that a laboratory meets: one file of a twin is not as it should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Fault {
    /// The mesh ends in the middle of a line.
    CutMesh,
    /// The force record lacks its last column.
    MissingColumn,
    /// The manifest names a mesh that is not there.
    MissingMesh,
    /// The manifest is no TOML.
    NoToml,
    /// The friction is negative.
    NegativeFriction,
    /// A pose of the track is not a number.
    NanPose,
    /// The clocks of track and force are an hour apart.
    ClocksApart,
    /// The grasps name a joint that the hand does not have.
    UnknownJoint,
}

impl Fault {
    /// All faults, in the order in which broken twins have them.
    pub const ALL: [Self; 8] = [
        Self::CutMesh,
        Self::MissingColumn,
        Self::MissingMesh,
        Self::NoToml,
        Self::NegativeFriction,
        Self::NanPose,
        Self::ClocksApart,
        Self::UnknownJoint,
    ];

    /// Its name in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::CutMesh => "cut_mesh",
            Self::MissingColumn => "missing_column",
            Self::MissingMesh => "missing_mesh",
            Self::NoToml => "no_toml",
            Self::NegativeFriction => "negative_friction",
            Self::NanPose => "nan_pose",
            Self::ClocksApart => "clocks_apart",
            Self::UnknownJoint => "unknown_joint",
        }
    }

    /// The file that has it.
    pub(super) fn file(self) -> &'static str {
        match self {
            Self::CutMesh => "scan/tin.obj",
            Self::MissingMesh | Self::NoToml | Self::NegativeFriction => "twin.toml",
            Self::MissingColumn => "push/tilt/force.csv",
            Self::NanPose => "push/tilt/poses.csv",
            Self::ClocksApart => "push/tilt/push.toml",
            Self::UnknownJoint => "demos/grasps.json",
        }
    }

    /// The file with the fault.
    pub(super) fn spoil(self, text: &str) -> String {
        match self {
            Self::CutMesh => {
                // Half of a line has too few numbers, whatever stands on it.
                let begin = text[..text.len() / 2].rfind('\n').map_or(0, |at| at + 1);
                let length = text[begin..].find('\n').unwrap_or(0);
                text[..begin + length / 2].to_owned()
            }
            Self::MissingColumn => {
                text.lines().filter_map(|l| l.rsplit_once(',')).map(|(kept, _)| format!("{kept}\n")).collect()
            }
            Self::MissingMesh => text.replace("scan/tin.obj", "scan/can.obj"),
            Self::NoToml => text.replace("[object]", "[object"),
            Self::NegativeFriction => text.replace("friction = ", "friction = -"),
            Self::NanPose => {
                let spoilt = |(i, l): (usize, &str)| match l.split_once(',') {
                    Some((t, rest)) if i == NAN_LINE => {
                        format!("{t},NaN{}\n", rest.find(',').map_or("", |at| &rest[at..]))
                    }
                    _ => format!("{l}\n"),
                };
                text.lines().enumerate().map(spoilt).collect()
            }
            Self::ClocksApart => text.replace("[force.clock]\n", "[force.clock]\noffset_s = 3600.0\n"),
            Self::UnknownJoint => text.replace("\"th_ipl\"", "\"thumb_tip\""),
        }
    }
}

/// Line of the track, after the header, whose position is not a number.
const NAN_LINE: usize = 20;
