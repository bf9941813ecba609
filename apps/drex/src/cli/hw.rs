//! `drex hw`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand, ValueEnum};
use drex_hw::allegro::AllegroVersion;
use drex_hw::driver::{GuardSettings, HandKind, SetupOptions};
use drex_hw::leap::FindingKind;

use super::values::positive;

/// `drex hw`.
#[derive(Debug, Subcommand)]
pub enum HwCommand {
    /// Say who answers.
    Ping(HandArgs),
    /// Read angles, currents, temperatures and voltages, and say what is not as it should be.
    Status(HandArgs),
    /// Take the torque off all joints of a hand in any state, and say of each motor what is known.
    Off(HandArgs),
    /// Let go gently: the force of all joints falls to nothing where they are, then the torque goes off.
    Release(ReleaseArgs),
    /// Move joints to angles, slowly, pressing no harder than allowed.
    Move(MoveArgs),
    /// Write angles and efforts to a joint log, the hand limp or playing a log.
    Record(RecordArgs),
    /// Find the law of current and torque of a motor from measured pairs.
    Calibrate(CalibrateArgs),
    /// Write a hand file with the zeros of a hand that somebody holds in a known pose.
    CalibrateZero(CalibrateZeroArgs),
    /// Be a hand without hardware, at a pseudo-terminal, until Ctrl-C.
    Emulate(EmulateArgs),
    /// Be the guard of the program at the standard input: started by the commands that drive a hand.
    #[command(hide = true)]
    Guard,
}

/// The hand and where it is.
#[derive(Debug, Args)]
pub struct HandArgs {
    /// Which hand.
    #[arg(long, value_enum)]
    pub hand: HandArg,
    /// Serial port of the hand, such as /dev/ttyUSB0; for Allegro that of an slcan adapter, or a CAN interface such as can0.
    #[arg(long, value_name = "PATH")]
    pub port: PathBuf,
    /// How it is driven.
    #[command(flatten)]
    pub link: LinkArgs,
}

/// Speed, generation, cap and hand file.
#[derive(Debug, Default, Args)]
pub struct LinkArgs {
    /// Speed of the LEAP bus, bits per second [default: 4000000].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(9_600..=10_500_000))]
    pub baud: Option<u32>,
    /// Generation of the Allegro hand [default: v4].
    #[arg(long, value_enum, value_name = "VERSION")]
    pub allegro: Option<AllegroArg>,
    /// No joint presses with more than this: mA for LEAP, N m for Allegro [default: a gentle one for the motors].
    #[arg(long, value_name = "EFFORT", value_parser = positive)]
    pub cap: Option<f64>,
    /// Zeros, signs, side, cap and gears of this one hand, as `drex hw calibrate-zero` writes them.
    #[arg(long, value_name = "TOML")]
    pub hand_file: Option<PathBuf>,
}

/// Findings in spite of which a hand moves.
#[derive(Debug, Default, Args)]
pub struct AllowArgs {
    /// Move in spite of these findings, which otherwise stop the hand before it moves.
    #[arg(long, value_enum, value_name = "FINDING,…", value_delimiter = ',')]
    pub allow: Vec<AllowArg>,
}

/// Findings that stop motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum AllowArg {
    /// A motor adds an offset that its zero does not know.
    HomingOffset,
    /// A motor listens to a second id.
    SecondId,
    /// A motor had a hardware error when it was looked at.
    HardwareError,
    /// Less than 4.5 V.
    LowVoltage,
    /// More than 5.5 V.
    HighVoltage,
    /// A motor of 60 °C or more.
    Hot,
}

impl From<AllowArg> for FindingKind {
    fn from(allow: AllowArg) -> Self {
        match allow {
            AllowArg::HomingOffset => Self::HomingOffset,
            AllowArg::SecondId => Self::SecondId,
            AllowArg::HardwareError => Self::HardwareError,
            AllowArg::LowVoltage => Self::LowVoltage,
            AllowArg::HighVoltage => Self::HighVoltage,
            AllowArg::Hot => Self::Hot,
        }
    }
}

/// What is done about a program that dies and a hand that is out of reach.
#[derive(Debug, Args)]
pub struct GuardArgs {
    /// Drive the hand without a guard: when this program is killed or hangs, the torque stays on.
    #[arg(long)]
    pub no_guard: bool,
    /// Silence of this program after which the guard takes the torque off, ms [default: 40, or three cycles where these take longer].
    #[arg(long, value_name = "MS", value_parser = positive, conflicts_with = "no_guard")]
    pub heartbeat: Option<f64>,
    /// How long the hand may be out of reach, its plug pulled for instance, s: it goes on when it is back by then, else its torque goes
    /// off when it is back.
    #[arg(long, value_name = "S", default_value = "3", value_parser = seconds)]
    pub outage: Duration,
}

impl GuardArgs {
    /// How the guard is started; `None` where there is to be none.
    pub fn settings(&self) -> Option<GuardSettings> {
        let heartbeat = self.heartbeat.map(|ms| Duration::try_from_secs_f64(1e-3 * ms).unwrap_or(Duration::MAX));
        (!self.no_guard).then_some(GuardSettings { arguments: &["hw", "guard"], heartbeat })
    }
}

impl LinkArgs {
    /// The same as a library takes it.
    pub fn options(&self) -> SetupOptions {
        SetupOptions {
            baud: self.baud,
            version: self.allegro.map(Into::into),
            cap: self.cap,
            hand_file: self.hand_file.clone(),
        }
    }
}

impl AllowArgs {
    /// The findings in spite of which a hand moves.
    pub fn kinds(&self) -> Vec<FindingKind> {
        self.allow.iter().map(|a| FindingKind::from(*a)).collect()
    }
}

impl From<HandArg> for HandKind {
    fn from(arg: HandArg) -> Self {
        match arg {
            HandArg::Leap => Self::Leap,
            HandArg::Allegro => Self::Allegro,
        }
    }
}

impl From<AllegroArg> for AllegroVersion {
    fn from(arg: AllegroArg) -> Self {
        match arg {
            AllegroArg::V3 => Self::V3,
            AllegroArg::V4 => Self::V4,
            AllegroArg::V5 => Self::V5,
        }
    }
}

impl Default for GuardArgs {
    fn default() -> Self {
        Self { no_guard: false, heartbeat: None, outage: Duration::from_secs(3) }
    }
}

/// A time that is not negative, s.
fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().map_err(|_| "expected a number of seconds")?;
    Duration::try_from_secs_f64(seconds).map_err(|_| "expected a number of seconds that is not negative".into())
}

/// `drex hw release`.
#[derive(Debug, Args)]
pub struct ReleaseArgs {
    /// The hand.
    #[command(flatten)]
    pub hand: HandArgs,
    /// Time in which the force falls, s.
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = release_time)]
    pub seconds: f64,
}

/// A time in which a force may fall, s.
fn release_time(text: &str) -> Result<f64, String> {
    positive(text).and_then(|s| if s <= 10.0 { Ok(s) } else { Err("give at most 10 s".into()) })
}

/// `drex hw calibrate-zero`.
#[derive(Debug, Args)]
pub struct CalibrateZeroArgs {
    /// The hand; what its hand file says beside the zeros is kept.
    #[command(flatten)]
    pub hand: HandArgs,
    /// Pose in which it is held: `rest`, all joints at 0, or joints and angles in rad, as in if_mcp=0.5,th_cmc=0.2; the others at 0.
    #[arg(long, value_name = "JOINT=RAD,…", default_value = "rest", allow_hyphen_values = true)]
    pub pose: String,
    /// How long it is read, s.
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = positive)]
    pub seconds: f64,
    /// File to write.
    #[arg(long, value_name = "TOML", default_value = "hand.toml")]
    pub out: PathBuf,
}

/// `drex hw move`.
#[derive(Debug, Args)]
pub struct MoveArgs {
    /// The hand.
    #[command(flatten)]
    pub hand: HandArgs,
    /// `rest`, or joints and angles in rad, as in if_mcp=0.5,th_cmc=0.2; the others stay.
    #[arg(long, value_name = "JOINT=RAD,…", allow_hyphen_values = true)]
    pub to: String,
    /// Time of the way, s.
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = positive)]
    pub seconds: f64,
    /// How to run it.
    #[command(flatten)]
    pub run: RunArgs,
    /// What can go wrong.
    #[command(flatten)]
    pub guard: GuardArgs,
    /// In spite of what.
    #[command(flatten)]
    pub allow: AllowArgs,
}

/// `drex hw record`.
#[derive(Debug, Args)]
pub struct RecordArgs {
    /// The hand.
    #[command(flatten)]
    pub hand: HandArgs,
    /// How long to watch the limp hand, s.
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = positive, conflicts_with = "play")]
    pub seconds: f64,
    /// Joint log to play while recording.
    #[arg(long, value_name = "CSV")]
    pub play: Option<PathBuf>,
    /// Cycles per second.
    #[arg(long, value_name = "HZ", default_value_t = 400.0, value_parser = positive)]
    pub rate: f64,
    /// File to write.
    #[arg(long, value_name = "CSV")]
    pub out: PathBuf,
    /// What can go wrong.
    #[command(flatten)]
    pub guard: GuardArgs,
    /// In spite of what.
    #[command(flatten)]
    pub allow: AllowArgs,
}

/// Rate and log of a loop.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Cycles per second.
    #[arg(long, value_name = "HZ", default_value_t = Self::RATE_HZ, value_parser = positive)]
    pub rate: f64,
    /// Joint log to write.
    #[arg(long, value_name = "CSV")]
    pub log: Option<PathBuf>,
}

impl RunArgs {
    /// Cycles per second where nobody says otherwise.
    pub const RATE_HZ: f64 = 400.0;
}

/// `drex hw calibrate`.
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    /// Pairs at standstill: a CSV with the columns current_ma and torque_nm, or current_ma and force_n; a column approach says loading or
    /// unloading.
    pub pairs: PathBuf,
    /// Lever arm of the forces, m.
    #[arg(long, value_name = "M", value_parser = positive)]
    pub lever: Option<f64>,
    /// Who measured what, and how.
    #[arg(long, value_name = "TEXT")]
    pub source: String,
    /// Day of the measurement.
    #[arg(long, value_name = "YYYY-MM-DD")]
    pub date: String,
    /// File to write, for `drex deploy --law`.
    #[arg(long, value_name = "FILE", default_value = "law.json")]
    pub out: PathBuf,
}

/// `drex hw emulate`.
#[derive(Debug, Args)]
pub struct EmulateArgs {
    /// Which hand.
    #[arg(value_enum)]
    pub hand: HandArg,
    /// Link to make to the pseudo-terminal.
    #[arg(long, value_name = "PATH")]
    pub link: Option<PathBuf>,
    /// Generation of the Allegro hand.
    #[arg(long, value_enum, value_name = "VERSION", default_value_t = AllegroArg::V4)]
    pub allegro: AllegroArg,
    /// Speed of the LEAP bus; without it answers come at once.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(9_600..=10_500_000))]
    pub baud: Option<u32>,
    /// Something in the way of joints: angles that they cannot pass closing, rad, as in if_mcp=0.5.
    #[arg(long, value_name = "JOINT=RAD,…")]
    pub wall: Option<String>,
    /// Motors of the LEAP hand.
    #[arg(long, value_enum, value_name = "MOTOR", default_value_t = MotorArg::Xc330)]
    pub motors: MotorArg,
    /// A fault of the LEAP hand, once or more: supply=V, supply-resistance=OHM (a brown-out under load), latency=MS (of the USB adapter),
    /// stuck-encoder=JOINT, current-sensor=JOINT:FACTOR, homing-offset=JOINT:TICKS, hardware-error=JOINT:BITS, mute=JOINT.
    #[arg(long, value_name = "FAULT=VALUE")]
    pub fault: Vec<String>,
    /// Stop by itself after this time, s.
    #[arg(long, value_name = "S", value_parser = positive)]
    pub seconds: Option<f64>,
}

/// Hands that can be driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum HandArg {
    /// LEAP, over Dynamixel.
    Leap,
    /// Allegro, over CAN.
    Allegro,
}

impl HandArg {
    /// The hand of this name on the command line.
    pub fn of_family(name: &str) -> Option<Self> {
        Self::from_str(name, false).ok()
    }

    /// Name of the bundled model of a left hand.
    pub fn left_robot(self) -> &'static str {
        match self {
            Self::Leap => "leap_left",
            Self::Allegro => "allegro_left",
        }
    }

    /// Name of the bundled model of a right hand.
    pub fn robot(self) -> &'static str {
        match self {
            Self::Leap => "leap_right",
            Self::Allegro => "allegro_right",
        }
    }
}

/// Motors of LEAP hands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MotorArg {
    /// XC330-M288, of the full hand.
    Xc330,
    /// XL330-M288, of the lite hand.
    Xl330,
}

/// Generations of the Allegro hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum AllegroArg {
    /// Version 3.
    V3,
    /// Version 4.
    V4,
    /// Version 5.
    V5,
}
