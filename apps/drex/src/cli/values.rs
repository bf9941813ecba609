//! Values of options: what may be written, and what is said where something else is.

use drex_core::Pose;
use drex_core::pose::pose_from_wxyz;
use drex_mesh::KnownDistance;
use drex_sysid::Parameter;
use nalgebra::{Point3, Similarity3};

/// A finite number above zero.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err("expected a positive number".into()),
    }
}

/// A parameter of the push and its value, `NAME=VALUE`.
pub fn named_value(text: &str) -> Result<(Parameter, f64), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE, such as friction=0.4")?;
    let parameter = name.trim().parse::<Parameter>().map_err(|e| e.to_string())?;
    Ok((parameter, value.trim().parse().map_err(|_| format!("`{value}` is no number"))?))
}

/// A parameter of the push, mean and standard deviation of its prior, `NAME=MEAN,SD`.
pub fn named_prior(text: &str) -> Result<(Parameter, [f64; 2]), String> {
    let (head, sd) = text.rsplit_once(',').ok_or("expected NAME=MEAN,SD, such as friction=0.4,0.1")?;
    let (parameter, mean) = named_value(head)?;
    Ok((parameter, [mean, sd.trim().parse().map_err(|_| format!("`{sd}` is no number"))?]))
}

/// Two positive numbers, the smaller first.
pub fn range(text: &str) -> Result<[f64; 2], String> {
    let (lo, hi) = text.split_once(',').ok_or("expected LOW,HIGH, such as 0.05,0.5")?;
    let (lo, hi) = (positive(lo.trim())?, positive(hi.trim())?);
    if lo <= hi { Ok([lo, hi]) } else { Err("expected the smaller number first".into()) }
}

/// [`range`], or a positive number twice.
pub fn interval(text: &str) -> Result<(f64, f64), String> {
    match text.contains(',') {
        true => range(text).map(|[low, high]| (low, high)),
        false => positive(text).map(|number| (number, number)),
    }
}

/// Two marks and the metres between them, `A-C=0.12`.
pub fn known_distance(text: &str) -> Result<KnownDistance, String> {
    let wrong = || "expected two marks and metres, such as A-C=0.12".to_owned();
    let (marks, metres) = text.split_once('=').ok_or_else(wrong)?;
    let (from, to) = marks.split_once('-').ok_or_else(wrong)?;
    let distance_m = positive(metres.trim())?;
    Ok(KnownDistance { from: from.trim().to_owned(), to: to.trim().to_owned(), distance_m })
}

/// Lower and upper corner of a box.
pub fn region(text: &str) -> Result<[Point3<f64>; 2], String> {
    let [x0, y0, z0, x1, y1, z1] = numbers(text)?;
    if x0 < x1 && y0 < y1 && z0 < z1 {
        Ok([Point3::new(x0, y0, z0), Point3::new(x1, y1, z1)])
    } else {
        Err("the second corner must be above the first along x, y and z".into())
    }
}

/// `X,Y,Z,QW,QX,QY,QZ`, metres and a quaternion.
pub fn pose(text: &str) -> Result<Pose, String> {
    let [x, y, z, qw, qx, qy, qz] = numbers(text)?;
    pose_from_wxyz([x, y, z], [qw, qx, qy, qz]).map_err(|e| e.to_string())
}

/// Three numbers, not all zero.
pub fn direction(text: &str) -> Result<[f64; 3], String> {
    match numbers(text)? {
        d if d.iter().map(|v| v * v).sum::<f64>() > 1e-12 => Ok(d),
        _ => Err("expected a direction as three numbers X,Y,Z, not all zero".into()),
    }
}

/// `N` finite numbers with commas between them.
pub fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers = text.split(',').map(|s| s.trim().parse().ok().filter(|v: &f64| v.is_finite()));
    let numbers: Option<Vec<f64>> = numbers.collect();
    numbers.and_then(|v| v.try_into().ok()).ok_or_else(|| format!("expected {N} numbers with commas between them"))
}

/// `WIDTHxHEIGHT` in pixels.
pub fn size(text: &str) -> Result<[usize; 2], String> {
    let sides = text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.trim().parse().ok()?, h.trim().parse().ok()?]));
    sides.filter(|[w, h]| *w > 0 && *h > 0).ok_or_else(|| "expected WIDTHxHEIGHT in pixels, such as 640x480".into())
}

/// A scale alone, or a scale and a pose.
pub fn similarity(text: &str) -> Result<Similarity3<f64>, String> {
    if !text.contains(',') {
        return Ok(Similarity3::from_scaling(positive(text)?));
    }
    let [s, x, y, z, qw, qx, qy, qz] = numbers(text)?;
    let pose = pose_from_wxyz([x, y, z], [qw, qx, qy, qz]).map_err(|e| e.to_string())?;
    if s > 0.0 { Ok(Similarity3::from_isometry(pose, s)) } else { Err("expected a positive scale".into()) }
}
