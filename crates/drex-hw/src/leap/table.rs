//! The control table of the XC330-M288 and XL330-M288 motors, typed.

use std::marker::PhantomData;

use crate::Result;
use crate::dynamixel::{Bus, Port};
use crate::torque_current::Nominal;

/// A number in a control table.
pub trait Value: Copy {
    /// Bytes it takes.
    const LEN: usize;
    /// Its bytes, low first; the first [`Value::LEN`] count.
    fn bytes(self) -> [u8; 4];
    /// From its bytes, low first.
    fn from_bytes(bytes: [u8; 4]) -> Self;
}

macro_rules! value {
    ($($kind:ty),*) => {$(
        impl Value for $kind {
            const LEN: usize = size_of::<$kind>();
            fn bytes(self) -> [u8; 4] {
                let mut all = [0; 4];
                all[..Self::LEN].copy_from_slice(&self.to_le_bytes());
                all
            }
            fn from_bytes(bytes: [u8; 4]) -> Self {
                // Exactly what `bytes` wrote: the upper bytes are dropped.
                u32::from_le_bytes(bytes) as $kind
            }
        }
    )*};
}
value!(u8, u16, i16, u32, i32);

/// A place in a control table that holds a `T`.
#[derive(Debug)]
pub struct Register<T> {
    /// Where.
    pub address: u16,
    holds: PhantomData<T>,
}

impl<T> Clone for Register<T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T> Copy for Register<T> {}

impl<T: Value> Register<T> {
    const fn at(address: u16) -> Self {
        Self { address, holds: PhantomData }
    }

    /// Its value in `block`, which starts at address `start`; 0 if it is not in there.
    pub fn in_block(self, start: u16, block: &[u8]) -> T {
        let from = usize::from(self.address.wrapping_sub(start));
        let mut bytes = [0; 4];
        if let Some(found) = block.get(from..from + T::LEN) {
            bytes[..T::LEN].copy_from_slice(found);
        }
        T::from_bytes(bytes)
    }
}

macro_rules! registers {
    ($($(#[$doc:meta])* $name:ident: $kind:ty = $address:literal;)*) => {$(
        $(#[$doc])*
        pub const $name: Register<$kind> = Register::at($address);
    )*};
}

registers! {
    /// Model number.
    MODEL_NUMBER: u16 = 0;
    /// Version of the firmware.
    FIRMWARE: u8 = 6;
    /// Id on the bus.
    ID: u8 = 7;
    /// Code of the speed; 6 is 4 Mbaud.
    BAUD: u8 = 8;
    /// Time before an answer, 2 µs.
    RETURN_DELAY: u8 = 9;
    /// Direction, profiles, and whether a goal switches the torque on; 0 is none of it.
    DRIVE_MODE: u8 = 10;
    /// Operating mode; 5 is current-based position.
    MODE: u8 = 11;
    /// Second id to which it listens; 253 and more is none.
    SHADOW_ID: u8 = 12;
    /// Added to the position, ticks.
    HOMING_OFFSET: i32 = 20;
    /// Temperature at which it shuts down, °C.
    TEMPERATURE_LIMIT: u8 = 31;
    /// Largest supply voltage, 0.1 V.
    MAX_VOLTAGE: u16 = 32;
    /// Smallest supply voltage, 0.1 V.
    MIN_VOLTAGE: u16 = 34;
    /// Largest PWM, 0.113 %.
    PWM_LIMIT: u16 = 36;
    /// Largest current, mA.
    CURRENT_LIMIT: u16 = 38;
    /// What it does when power comes: 1 is torque on, 2 is old values back.
    STARTUP: u8 = 60;
    /// Hardware errors that take the torque off.
    SHUTDOWN: u8 = 63;
    /// Whether it is under torque.
    TORQUE_ENABLE: u8 = 64;
    /// To which instructions it answers.
    STATUS_LEVEL: u8 = 68;
    /// Hardware errors, one bit each.
    HARDWARE_ERROR: u8 = 70;
    /// Gain on the change of the position error.
    POSITION_D: u16 = 80;
    /// Gain on the sum of the position error.
    POSITION_I: u16 = 82;
    /// Gain on the position error.
    POSITION_P: u16 = 84;
    /// Feed-forward of acceleration; that of velocity follows.
    FEEDFORWARD: u16 = 88;
    /// Time without instructions after which it freezes, 20 ms; 255 when it has.
    BUS_WATCHDOG: u8 = 98;
    /// Largest PWM of the moment.
    GOAL_PWM: i16 = 100;
    /// Largest current of the moment, mA.
    GOAL_CURRENT: i16 = 102;
    /// Acceleration of moves; their velocity follows. 0 is no limit.
    PROFILE_ACCELERATION: u32 = 108;
    /// Goal position, ticks.
    GOAL_POSITION: i32 = 116;
    /// Current, mA.
    PRESENT_CURRENT: i16 = 126;
    /// Velocity, 0.229 rpm.
    PRESENT_VELOCITY: i32 = 128;
    /// Position, ticks.
    PRESENT_POSITION: i32 = 132;
    /// Supply voltage, 0.1 V.
    PRESENT_VOLTAGE: u16 = 144;
    /// Temperature, °C.
    PRESENT_TEMPERATURE: u8 = 146;
    /// First of 20 addresses that the indirect data show.
    INDIRECT_ADDRESS: u16 = 168;
    /// First of 20 bytes that stand for others.
    INDIRECT_DATA: u8 = 208;
}

/// Mode in which a position is held with a limited current.
pub const CURRENT_BASED_POSITION: u8 = 5;
/// Ticks of one turn.
pub const TICKS_PER_TURN: i32 = 4096;
/// Radians per tick.
pub const RAD_PER_TICK: f64 = std::f64::consts::TAU / 4096.0;
/// Radians per second per unit of velocity (0.229 rpm).
pub const RAD_S_PER_UNIT: f64 = 0.229 * std::f64::consts::TAU / 60.0;

/// Bits of the hardware error register.
pub mod hardware_error {
    /// The supply voltage is out of range.
    pub const VOLTAGE: u8 = 1;
    /// Too hot.
    pub const OVERHEAT: u8 = 1 << 2;
    /// The position sensor fails.
    pub const ENCODER: u8 = 1 << 3;
    /// Electrical shock, or not enough power.
    pub const SHOCK: u8 = 1 << 4;
    /// More load than it can bear for long.
    pub const OVERLOAD: u8 = 1 << 5;
}

/// What a hardware error register says, in words.
pub fn hardware_error_text(bits: u8) -> String {
    use hardware_error::{ENCODER, OVERHEAT, OVERLOAD, SHOCK, VOLTAGE};
    let names = [
        (VOLTAGE, "supply voltage out of range"),
        (OVERHEAT, "too hot"),
        (ENCODER, "position sensor fails"),
        (SHOCK, "electrical shock or too little power"),
        (OVERLOAD, "overload"),
    ];
    let said: Vec<_> = names.iter().filter(|(bit, _)| bits & bit != 0).map(|(_, name)| *name).collect();
    if said.is_empty() { format!("error bits {bits:#04x}") } else { said.join(", ") }
}

/// The motors of LEAP hands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum MotorModel {
    /// XC330-M288-T, of the full hand.
    Xc330M288,
    /// XL330-M288-T, of the lite hand.
    Xl330M288,
}

impl MotorModel {
    /// The motor with this model number.
    pub fn from_number(number: u16) -> Option<Self> {
        [Self::Xc330M288, Self::Xl330M288].into_iter().find(|m| m.number() == number)
    }

    /// Its model number.
    pub fn number(self) -> u16 {
        match self {
            Self::Xc330M288 => 1240,
            Self::Xl330M288 => 1200,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Xc330M288 => "XC330-M288",
            Self::Xl330M288 => "XL330-M288",
        }
    }

    /// Largest current limit that it takes, mA.
    pub fn current_limit_max_ma(self) -> u16 {
        match self {
            Self::Xc330M288 => 2352,
            Self::Xl330M288 => 1750,
        }
    }

    /// Current to start with, mA: our choice, about a tenth of the stall torque by the data sheet's constant, half of what the motor's
    /// maker asks not to exceed for smooth motion.
    pub fn gentle_cap_ma(self) -> f64 {
        match self {
            Self::Xc330M288 => 200.0,
            Self::Xl330M288 => 150.0,
        }
    }

    /// Current that the authors of the LEAP hand recommend not to exceed, mA.
    pub fn recommended_cap_ma(self) -> f64 {
        match self {
            Self::Xc330M288 => 550.0,
            Self::Xl330M288 => 300.0,
        }
    }

    /// Stall current at 5 V as the motor's maker states it, mA: more cannot be meant.
    pub fn peak_ma(self) -> f64 {
        match self {
            Self::Xc330M288 => 1800.0,
            Self::Xl330M288 => 1470.0,
        }
    }

    /// Refuses a cap above the motor's peak.
    ///
    /// # Errors
    /// [`Error::Value`](crate::Error::Value) with the peak and what is recommended.
    pub fn check_cap_ma(self, cap_ma: f64) -> Result<()> {
        if cap_ma <= self.peak_ma() {
            return Ok(());
        }
        let (name, peak, recommended, gentle) =
            (self.name(), self.peak_ma(), self.recommended_cap_ma(), self.gentle_cap_ma());
        Err(crate::Error::value(
            format!("a cap of {cap_ma} mA, above the {peak} mA at which an {name} stalls"),
            format!("start with {gentle} mA; the authors of the LEAP hand recommend at most {recommended} mA"),
        ))
    }

    /// Published torque-current models of this motor; the first is the data sheet's.
    pub fn torque_current_models(self) -> &'static [Nominal] {
        match self {
            Self::Xc330M288 => Nominal::XC330,
            Self::Xl330M288 => Nominal::XL330,
        }
    }

    /// Hardware errors that take its torque off, as it comes from the factory.
    pub fn default_shutdown(self) -> u8 {
        match self {
            Self::Xc330M288 => 52,
            Self::Xl330M288 => 53,
        }
    }

    /// Gains P and D as it comes from the factory.
    pub fn default_gains(self) -> (u16, u16) {
        match self {
            Self::Xc330M288 => (1100, 500),
            Self::Xl330M288 => (400, 0),
        }
    }
}

impl<P: Port> Bus<P> {
    /// Reads a register of motor `id`.
    ///
    /// # Errors
    /// As [`Bus::read`].
    pub fn get<T: Value>(&mut self, id: u8, register: Register<T>) -> Result<T> {
        let mut bytes = [0; 4];
        self.read(id, register.address, &mut bytes[..T::LEN])?;
        Ok(T::from_bytes(bytes))
    }

    /// Writes a register of motor `id`.
    ///
    /// # Errors
    /// As [`Bus::write`].
    pub fn set<T: Value>(&mut self, id: u8, register: Register<T>, value: T) -> Result<()> {
        self.write(id, register.address, &value.bytes()[..T::LEN]).map(|_| ())
    }
}
