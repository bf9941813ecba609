//! Order statistics of small samples, and normal numbers.

use nalgebra::RealField;

/// Median of `values`: the middle one, or the mean of the two in the middle. `None` of nothing.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let (middle, odd) = (values.len() / 2, values.len() % 2 == 1);
    let upper = nth(&mut values, middle)?;
    Some(if odd { upper } else { 0.5 * (upper + nth(&mut values, middle - 1)?) })
}

/// Median of `values` that is one of them: the middle one, or the upper of the two in the middle. `None` of nothing.
pub fn upper_median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let middle = values.len() / 2;
    nth(&mut values, middle)
}

/// The value of `values` below which nearly a `share` (0 to 1) of them lies: the one of the nearest rank. `None` of nothing.
pub fn quantile(values: impl IntoIterator<Item = f64>, share: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let rank = ((values.len() as f64 - 1.0) * share).round() as usize;
    nth(&mut values, rank)
}

/// Two independent standard normal numbers (Box and Muller 1958) from `uniform` in 0 to 1, 1 left out, and an angle of the whole turn, rad.
pub fn normal_pair<T: RealField + Copy>(uniform: T, angle_rad: T) -> [T; 2] {
    let radius = (-(T::one() + T::one()) * (T::one() - uniform).ln()).sqrt();
    let (sin, cos) = angle_rad.sin_cos();
    [radius * cos, radius * sin]
}

/// The value with `n` values below it.
fn nth(values: &mut [f64], n: usize) -> Option<f64> {
    (n < values.len()).then(|| *values.select_nth_unstable_by(n, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_quantiles_of_few_values() {
        for (values, middle, upper) in [
            (&[][..], None, None),
            (&[3.0], Some(3.0), Some(3.0)),
            (&[3.0, 1.0], Some(2.0), Some(3.0)),
            (&[5.0, 1.0, 2.0], Some(2.0), Some(2.0)),
            (&[8.0, 1.0, 2.0, 4.0], Some(3.0), Some(4.0)),
        ] {
            let values = || values.iter().copied();
            assert_eq!((median(values()), upper_median(values()), quantile(values(), 0.5)), (middle, upper, upper));
        }
        assert_eq!([0.0, 0.26, 0.9, 1.0].map(|s| quantile([4.0, 1.0, 3.0], s)), [1.0, 3.0, 4.0, 4.0].map(Some));
    }
}
