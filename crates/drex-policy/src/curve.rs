//! The learning curve of a run as CSV and as a picture.

use std::fmt::Write;

use crate::TrainReport;

/// Size of the picture and the room around the plot, px.
const SIZE: (f64, f64) = (720.0, 360.0);
const MARGIN: (f64, f64) = (60.0, 40.0);
const COLOURS: [&str; 5] = ["#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e"];

/// A line of the picture.
struct Line {
    name: &'static str,
    /// One value per epoch; what is not finite or not positive leaves a gap.
    values: Vec<f64>,
}

impl TrainReport {
    /// One row per epoch of the first phase, then, after an empty line, one per round of rollouts. Units are in the names of the columns;
    /// what was not measured is empty.
    pub fn curve_csv(&self) -> String {
        let mut text = String::from(
            "epoch,total,nll_nats,joint_loss_rad2,wrist_loss_m2,force_loss,contact_loss_nats,held_out_distance_m,held_out_joint_rms_rad,\
             held_out_wrist_m,held_out_wrist_rad,held_out_force_relative,held_out_log_likelihood_nats,held_out_joint_log_likelihood_nats\n",
        );
        for s in &self.curve {
            let errors = s.held_out.map(|e| [e.distance_m, e.joint_rms_rad, e.wrist_m, e.wrist_rad, e.force_relative]);
            let plain = [s.total, s.nll, s.joint_loss, s.wrist_loss, s.force_loss, s.contact_loss].map(Some);
            let errors = (0..5).map(|i| errors.map(|e| e[i]));
            let likelihoods = [s.held_out_log_likelihood, s.held_out_joint_log_likelihood];
            row(&mut text, s.epoch, plain.into_iter().chain(errors).chain(likelihoods));
        }
        if !self.rollouts.is_empty() {
            text.push_str(
                "\nround,tried,held,reward,policy_reward,force_gap,contact_loss_nats,joint_drift_rad,wrist_drift_m\n",
            );
        }
        for r in &self.rollouts {
            let values =
                [r.held, r.reward, r.policy_reward, r.force_gap, r.contact_loss, r.joint_drift_rad, r.wrist_drift_m];
            row(&mut text, r.epoch, std::iter::once(r.tried as f64).chain(values).map(Some));
        }
        text
    }

    /// The errors on grasps held out (or the losses, if none were) over the epochs of the first phase, on a logarithmic axis,
    /// as an SVG picture of its own.
    pub fn curve_svg(&self) -> String {
        let of = |name, value: &dyn Fn(&crate::EpochStats) -> Option<f64>| Line {
            name,
            values: self.curve.iter().map(|s| value(s).unwrap_or(f64::NAN)).collect(),
        };
        let lines = if self.held_out.is_some() {
            vec![
                of("held-out distance, m", &|s| s.held_out.map(|e| e.distance_m)),
                of("held-out joints RMS, rad", &|s| s.held_out.map(|e| e.joint_rms_rad)),
                of("held-out |grip force / needed - 1|", &|s| s.held_out.map(|e| e.force_relative)),
                of("training joints RMS, rad", &|s| Some(s.joint_loss.sqrt())),
            ]
        } else {
            vec![
                of("training joints RMS, rad", &|s| Some(s.joint_loss.sqrt())),
                of("training wrist RMS, m", &|s| Some(s.wrist_loss.sqrt())),
                of("training ln grip force RMS", &|s| Some(s.force_loss.sqrt())),
            ]
        };
        picture(&lines)
    }
}

fn row(text: &mut String, epoch: usize, values: impl Iterator<Item = Option<f64>>) {
    let _ = write!(text, "{epoch}"); // writing to a String cannot fail
    for value in values {
        text.push(',');
        if let Some(value) = value {
            let _ = write!(text, "{value:.6e}");
        }
    }
    text.push('\n');
}

fn picture(lines: &[Line]) -> String {
    let ((width, height), (left, top)) = (SIZE, MARGIN);
    let drawn = |v: &f64| v.is_finite() && *v > 0.0;
    let logs: Vec<f64> = lines.iter().flat_map(|l| &l.values).copied().filter(drawn).map(f64::log10).collect();
    let least = logs.iter().copied().fold(f64::INFINITY, f64::min);
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // Whole decades, at least one; without values, the one from 1 to 10.
    let (least, most) =
        if logs.is_empty() { (0.0, 1.0) } else { (least.floor(), most.ceil().max(least.floor() + 1.0)) };
    let epochs = lines.iter().map(|l| l.values.len()).max().unwrap_or(0);
    let x = |i: usize| left + (width - left - 20.0) * i as f64 / epochs.saturating_sub(1).max(1) as f64;
    let y = |log: f64| height - top - (height - 2.0 * top) * (log - least) / (most - least);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    let right = width - 20.0;
    for decade in least as i32..=most as i32 {
        let (at, text) = (y(f64::from(decade)), left - 6.0);
        let _ = writeln!(
            svg,
            "<line x1=\"{left}\" y1=\"{at:.1}\" x2=\"{right}\" y2=\"{at:.1}\" stroke=\"#ccc\"/>\
             <text x=\"{text}\" y=\"{at:.1}\" text-anchor=\"end\">1e{decade}</text>"
        );
    }
    let foot = height - top + 16.0;
    for i in [0, epochs.saturating_sub(1) / 2, epochs.saturating_sub(1)] {
        let _ = writeln!(svg, "<text x=\"{:.1}\" y=\"{foot}\" text-anchor=\"middle\">epoch {i}</text>", x(i));
    }
    for (i, line) in lines.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        let mut path = String::new();
        let mut pen = 'M';
        for (e, value) in line.values.iter().enumerate() {
            if drawn(value) {
                let _ = write!(path, "{pen}{:.1} {:.1} ", x(e), y(value.log10()));
                pen = 'L';
            } else {
                pen = 'M';
            }
        }
        let (at, text) = (left + 10.0 + 165.0 * i as f64, top - 16.0);
        let name = line.name;
        let _ = writeln!(
            svg,
            "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>\
             <text x=\"{at}\" y=\"{text}\" fill=\"{colour}\">{name}</text>"
        );
    }
    svg.push_str("</svg>\n");
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decade_is_as_high_as_the_next() {
        let svg = picture(&[Line { name: "a", values: vec![100.0, 10.0, f64::NAN, 1.0, 0.0] }]);
        // 100 at the top, 10 in the middle, then a gap, 1 at the bottom; zero has no logarithm.
        assert!(svg.contains("d=\"M60.0 40.0 L220.0 180.0 M540.0 320.0 \""), "{svg}");
        assert!(svg.contains(">1e0<") && svg.contains(">1e2<") && svg.ends_with("</svg>\n"));
        let empty = picture(&[]);
        assert!(!empty.contains("NaN") && !empty.contains("inf"), "{empty}");
    }
}
