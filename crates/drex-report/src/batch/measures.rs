//! What a row says, as numbers that can be compared and as words.

use drex_twin::batch::{Row, RunRecord, Status, Table};

/// Acceleration of gravity, m/s².
const GRAVITY_M_S2: f64 = 9.81;
/// A larger number is no count of trials that somebody ran.
const MOST_TRIALS: usize = 1_000_000;

/// A row with the numbers that are compared; each is absent where the row has none that makes sense.
pub struct Measured<'a> {
    /// The row.
    pub row: &'a Row,
    /// What its last run took.
    pub run: Option<&'a RunRecord>,
    /// Mass, kg.
    pub mass_kg: Option<f64>,
    /// Ends of the 95 % interval of the mass, kg.
    pub mass_interval_kg: Option<[f64; 2]>,
    /// Width of that interval as a share of the mass.
    pub relative_width: Option<f64>,
    /// Grip force, N.
    pub grip_force_n: Option<f64>,
    /// Grip force as a multiple of the weight.
    pub grip_per_weight: Option<f64>,
    /// Number of trials that held, and of all.
    pub trials: Option<[usize; 2]>,
    /// Wall time of an item that is done, s.
    pub seconds: Option<f64>,
}

impl<'a> Measured<'a> {
    /// The rows of a table, in its order.
    pub fn all(table: &'a Table) -> Vec<Self> {
        table.rows.iter().map(|row| Self::of(row, table.runs.get(&row.name).map(|(_, run)| run))).collect()
    }

    fn of(row: &'a Row, run: Option<&'a RunRecord>) -> Self {
        let mass_kg = positive(row.mass_kg);
        let ends = row.mass_low_kg.zip(positive(row.mass_high_kg));
        let ends = ends.filter(|(low, high)| (0.0..=*high).contains(low)).map(|(low, high)| [low, high]);
        let grip_force_n = positive(row.grip_force_n);
        let trials = row.held.zip(row.trials).filter(|(held, all)| held <= all && (1..=MOST_TRIALS).contains(all));
        let done = row.status == Status::Done;
        Self {
            row,
            run,
            mass_kg,
            mass_interval_kg: ends.filter(|_| mass_kg.is_some()),
            relative_width: mass_kg.zip(ends).and_then(|(mass, [low, high])| positive(Some((high - low) / mass))),
            grip_force_n,
            grip_per_weight: mass_kg.zip(grip_force_n).and_then(|(m, n)| positive(Some(n / (m * GRAVITY_M_S2)))),
            trials: trials.map(|(held, trials)| [held, trials]),
            seconds: run.filter(|_| done).and_then(|run| positive(Some(run.seconds))),
        }
    }

    /// Share of the trials that held.
    pub fn success_rate(&self) -> Option<f64> {
        self.trials.map(|[held, trials]| held as f64 / trials as f64)
    }
}

/// A value over zero that somebody may have measured.
pub fn positive(value: Option<f64>) -> Option<f64> {
    value.filter(|v| (1e-12..1e12).contains(v))
}

/// Trials that held and all trials of several rows.
pub fn pooled<'a>(items: impl IntoIterator<Item = &'a Measured<'a>>) -> [usize; 2] {
    let trials = items.into_iter().filter_map(|item| item.trials);
    trials.fold([0, 0], |[held, all], [h, n]| [held + h, all + n])
}

/// A number of three digits, or of all before the point where there are more.
pub fn digits(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let decimals = (2.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.decimals$}")
}

/// "205 g".
pub fn grams(kg: f64) -> String {
    format!("{} g", digits(1e3 * kg))
}

/// "101 to 418 g".
pub fn grams_between([low, high]: [f64; 2]) -> String {
    format!("{} to {} g", digits(1e3 * low), digits(1e3 * high))
}

/// "80 to 99 %".
pub fn percent_between(low: f64, high: f64) -> String {
    format!("{:.0} to {:.0} %", 100.0 * low, 100.0 * high)
}

/// "23 of 24 (95 %: 80 to 99 %)".
pub fn trials_text([held, trials]: [usize; 2]) -> String {
    let interval = drex_trial::wilson(held, trials);
    format!("{held} of {trials} (95 %: {})", percent_between(interval.low, interval.high))
}

/// "1 item", "12 items".
pub fn items_text(n: usize) -> String {
    format!("{n} item{}", if n == 1 { "" } else { "s" })
}

/// Seconds as a person reads them: "31.2 s", "12 min", "3.4 h".
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 300.0 => format!("{} s", digits(s)),
        s if s < 2.0 * 3600.0 => format!("{:.0} min", s / 60.0),
        s => format!("{} h", digits(s / 3600.0)),
    }
}
