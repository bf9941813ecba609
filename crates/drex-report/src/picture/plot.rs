//! Line plots and histograms as SVG text. Colours follow the page (`currentColor`) so that light and dark both read well.

use std::fmt::Write as _;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 260.0;
const LEFT: f64 = 62.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 28.0;
const BOTTOM: f64 = 44.0;

/// Series colours: distinguishable on light and dark, also for the colour-blind (Okabe and Ito's set).
pub const COLORS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

/// One line or cloud of points.
pub struct Series<'a> {
    /// Legend text; empty for none.
    pub label: &'a str,
    /// Horizontal values.
    pub x: &'a [f64],
    /// Vertical values; samples that are not finite break the line.
    pub y: &'a [f64],
    /// CSS colour.
    pub color: &'a str,
    /// Points instead of a line.
    pub dots: bool,
}

/// One bar of a histogram, which stands on zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bar {
    /// Left end.
    pub from: f64,
    /// Right end.
    pub to: f64,
    /// How many values lie between them.
    pub count: usize,
}

/// A plot with axes, ticks, legend and optional marks.
#[derive(Default)]
pub struct Plot<'a> {
    /// Heading.
    pub title: &'a str,
    /// Label of the horizontal axis, with its unit.
    pub x_label: &'a str,
    /// Label of the vertical axis, with its unit.
    pub y_label: &'a str,
    /// The data.
    pub series: Vec<Series<'a>>,
    /// The bars of a histogram; the vertical axis then begins at zero and has whole numbers only.
    pub bars: Vec<Bar>,
    /// Logarithmic horizontal axis (values must be positive).
    pub log_x: bool,
    /// Vertical lines at these x, each with a label.
    pub marks: Vec<(f64, String)>,
    /// A shaded range of x.
    pub band: Option<(f64, f64)>,
}

impl Plot<'_> {
    /// The plot as an `<svg>` element.
    pub fn to_svg(&self) -> String {
        let mut svg = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\" font-family=\"system-ui,sans-serif\" font-size=\"11\" fill=\"currentColor\"",
            escape(self.title)
        );
        let finite = |v: &f64| v.is_finite();
        let edges = self.bars.iter().flat_map(|b| [b.from, b.to]);
        let xs = self.series.iter().flat_map(|s| s.x).copied().chain(edges);
        let xs = xs.filter(finite).map(|x| self.map_x(x)).filter(finite);
        let heights = self.bars.iter().flat_map(|b| [0.0, b.count as f64]);
        let ys = self.series.iter().flat_map(|s| s.y).copied().chain(heights).filter(finite);
        let (Some((x0, x1)), Some((y0, y1))) = (range(xs), range(ys)) else {
            svg.push_str("><text x=\"20\" y=\"40\">no data</text></svg>");
            return svg;
        };
        if !self.log_x {
            // Where a reader's time is in the plot: values and pixels of the left and right end, top and bottom.
            let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
            let _ = write!(svg, " data-range=\"{x0:.6} {x1:.6} {LEFT} {right} {TOP} {bottom}\"");
        }
        svg.push('>');
        // Bars begin at zero, and leave room for the labels of marks above them.
        let (below, above) = if self.bars.is_empty() { (0.06, 0.06) } else { (0.0, 0.12) };
        let (y0, y1) = (y0 - below * (y1 - y0), y1 + above * (y1 - y0));
        let px = |x: f64| LEFT + (self.map_x(x) - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT);
        let py = |y: f64| HEIGHT - BOTTOM - (y - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM);
        self.axes(&mut svg, (x0, x1), (y0, y1), &px, &py);
        for bar in &self.bars {
            let (left, right, top) = (px(bar.from), px(bar.to), py(bar.count as f64));
            let _ = write!(
                svg,
                "<rect x=\"{:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{}\" opacity=\"0.85\"/>",
                left + 0.5,
                (right - left - 1.0).max(1.0),
                (HEIGHT - BOTTOM - top).max(0.0),
                COLORS[0]
            );
        }
        if let Some((a, b)) = self.band {
            let (a, b) = (px(a).clamp(LEFT, WIDTH - RIGHT), px(b).clamp(LEFT, WIDTH - RIGHT));
            let _ = write!(
                svg,
                "<rect x=\"{a:.1}\" y=\"{TOP}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"#0072b2\" opacity=\"0.12\"/>",
                (b - a).max(1.0),
                HEIGHT - TOP - BOTTOM
            );
        }
        for (x, label) in self.marks.iter().filter(|(x, _)| (x0..=x1).contains(&self.map_x(*x))) {
            let x = px(*x);
            // Near the right end there is room to the left only.
            let (at, anchor) = if x > WIDTH - 100.0 { (x - 4.0, " text-anchor=\"end\"") } else { (x + 4.0, "") };
            let _ = write!(
                svg,
                "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{TOP}\" y2=\"{:.1}\" stroke=\"currentColor\" stroke-dasharray=\"4 3\" opacity=\"0.7\"/><text x=\"{at:.1}\" y=\"{:.1}\"{anchor} opacity=\"0.85\">{}</text>",
                HEIGHT - BOTTOM,
                TOP + 11.0,
                escape(label)
            );
        }
        for s in &self.series {
            draw_series(&mut svg, s, &px, &py);
        }
        self.legend(&mut svg);
        svg.push_str("</svg>");
        svg
    }

    fn map_x(&self, x: f64) -> f64 {
        if self.log_x { x.log10() } else { x }
    }

    fn axes(&self, svg: &mut String, xr: (f64, f64), yr: (f64, f64), px: &dyn Fn(f64) -> f64, py: &dyn Fn(f64) -> f64) {
        let bottom = HEIGHT - BOTTOM;
        let _ = write!(
            svg,
            "<text x=\"{LEFT}\" y=\"16\" font-weight=\"600\" font-size=\"12.5\">{}</text>",
            escape(self.title)
        );
        let whole = |y: &f64| self.bars.is_empty() || (y - y.round()).abs() < 1e-9;
        for y in linear_ticks(yr.0, yr.1).into_iter().filter(whole) {
            let v = py(y);
            let _ = write!(
                svg,
                "<line x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{v:.1}\" y2=\"{v:.1}\" stroke=\"currentColor\" opacity=\"0.13\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" opacity=\"0.8\">{}</text>",
                WIDTH - RIGHT,
                LEFT - 6.0,
                v + 4.0,
                tick_label(y, yr.1 - yr.0)
            );
        }
        let decades = if self.log_x { log_ticks(xr.0, xr.1) } else { Vec::new() };
        // A short piece of a logarithmic axis is nearly a linear one.
        let (lo, hi) = if self.log_x { (10f64.powf(xr.0), 10f64.powf(xr.1)) } else { xr };
        let ticks = if decades.len() < 3 {
            linear_ticks(lo, hi).into_iter().map(|x| (x, tick_label(x, hi - lo))).collect()
        } else {
            decades.into_iter().map(|x| (x, x.to_string())).collect::<Vec<_>>()
        };
        for (x, text) in ticks {
            let u = px(x);
            let _ = write!(
                svg,
                "<line x1=\"{u:.1}\" x2=\"{u:.1}\" y1=\"{bottom}\" y2=\"{:.1}\" stroke=\"currentColor\" opacity=\"0.5\"/><text x=\"{u:.1}\" y=\"{:.1}\" text-anchor=\"middle\" opacity=\"0.8\">{text}</text>",
                bottom + 4.0,
                bottom + 17.0
            );
        }
        let _ = write!(
            svg,
            "<line x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{bottom}\" y2=\"{bottom}\" stroke=\"currentColor\" opacity=\"0.5\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text><text transform=\"translate(13 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            WIDTH - RIGHT,
            (LEFT + WIDTH - RIGHT) / 2.0,
            HEIGHT - 8.0,
            escape(self.x_label),
            (TOP + bottom) / 2.0,
            escape(self.y_label)
        );
    }

    fn legend(&self, svg: &mut String) {
        let mut x = WIDTH - RIGHT;
        for s in self.series.iter().rev().filter(|s| !s.label.is_empty()) {
            x -= 6.6 * s.label.chars().count() as f64 + 24.0;
            let _ = write!(
                svg,
                "<rect x=\"{x:.1}\" y=\"9\" width=\"12\" height=\"4\" fill=\"{}\"/><text x=\"{:.1}\" y=\"15\">{}</text>",
                s.color,
                x + 16.0,
                escape(s.label)
            );
        }
    }
}

fn draw_series(svg: &mut String, s: &Series<'_>, px: &dyn Fn(f64) -> f64, py: &dyn Fn(f64) -> f64) {
    let points = s.x.iter().zip(s.y).map(|(&x, &y)| (px(x), py(y)));
    if s.dots {
        for (x, y) in points.filter(|(x, y)| x.is_finite() && y.is_finite()) {
            let _ = write!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2\" fill=\"{}\"/>", s.color);
        }
        return;
    }
    let mut path = String::new();
    let mut pen_down = false;
    for (x, y) in points {
        if x.is_finite() && y.is_finite() {
            let _ = write!(path, "{}{x:.1} {y:.1}", if pen_down { "L" } else { "M" });
            pen_down = true;
        } else {
            pen_down = false;
        }
    }
    let _ = write!(svg, "<path d=\"{path}\" fill=\"none\" stroke=\"{}\" stroke-width=\"1.8\"/>", s.color);
}

/// Smallest and largest value, widened when they are equal.
fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let (lo, hi) = values.fold(None, |acc: Option<(f64, f64)>, v| match acc {
        None => Some((v, v)),
        Some((lo, hi)) => Some((lo.min(v), hi.max(v))),
    })?;
    let widen = if hi > lo { 0.0 } else { lo.abs().max(1e-9) * 0.5 };
    Some((lo - widen, hi + widen))
}

/// The smallest of 1, 2, 5 times a power of ten that is at least `least`.
pub(super) fn step_of(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|k| k * power).find(|&s| s >= least).unwrap_or(10.0 * power)
}

fn linear_ticks(lo: f64, hi: f64) -> Vec<f64> {
    let step = step_of((hi - lo) / 5.0);
    // A tick at an end may be off it by rounding.
    let first = (lo / step - 1e-9).ceil() as i64;
    let last = (hi / step + 1e-9).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// 1, 2, 5 times powers of ten between 10^lo and 10^hi.
fn log_ticks(lo: f64, hi: f64) -> Vec<f64> {
    (lo.floor() as i32..=hi.ceil() as i32)
        .flat_map(|e| [1.0, 2.0, 5.0].map(|k| k * 10f64.powi(e)))
        .filter(|x| (lo..=hi).contains(&x.log10()))
        .map(|x| (x * 1e9).round() / 1e9)
        .collect()
}

fn tick_label(value: f64, span: f64) -> String {
    let decimals = (1.0 - (span / 5.0).log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Text made safe inside HTML and SVG.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(linear_ticks(0.0, 1.0), vec![0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(log_ticks(-1.7, 0.31), vec![0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0]);
        assert_eq!(tick_label(0.6000000000000001, 1.0), "0.6");
    }

    #[test]
    fn text_is_escaped_and_gaps_break_the_line() {
        let plot = Plot {
            title: "a < b",
            series: vec![Series {
                label: "s",
                x: &[0.0, 1.0, 2.0, 3.0],
                y: &[0.0, f64::NAN, 1.0, 2.0],
                color: "red",
                dots: false,
            }],
            ..Plot::default()
        };
        let svg = plot.to_svg();
        assert!(svg.contains("a &lt; b"));
        let path = svg.split("<path d=\"").nth(1).and_then(|s| s.split('"').next()).unwrap();
        assert_eq!(path.matches('M').count(), 2, "{path}");
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn bars_stand_on_zero_and_are_counted_in_whole_numbers() {
        let bars = vec![Bar { from: 0.2, to: 0.21, count: 1 }, Bar { from: 0.21, to: 0.22, count: 3 }];
        let svg = Plot { title: "bars", bars, log_x: true, ..Plot::default() }.to_svg();
        let heights: Vec<f64> = attributes(&svg, "height");
        assert!((heights[1] - 3.0 * heights[0]).abs() < 0.3, "{heights:?}");
        let bottom = attributes(&svg, "y")[0] + heights[0];
        assert!((bottom - (HEIGHT - BOTTOM)).abs() < 0.11, "{bottom}");
        for tick in ["0", "1", "2", "3", "0.2", "0.21", "0.22"] {
            assert!(svg.contains(&format!(">{tick}</text>")), "{tick}");
        }
        assert!(!svg.contains(">0.5</text>") && !svg.contains(">1.5</text>"));
    }

    /// The numbers of this attribute of all rectangles.
    fn attributes(svg: &str, name: &str) -> Vec<f64> {
        let rectangles = svg.split("<rect ").skip(1);
        rectangles
            .map(|r| r.split(&format!("{name}=\"")).nth(1).unwrap().split('"').next().unwrap().parse().unwrap())
            .collect()
    }

    #[test]
    fn nothing_to_plot_says_so() {
        assert!(Plot { title: "empty", ..Plot::default() }.to_svg().contains("no data"));
    }
}
