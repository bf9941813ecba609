//! How good pictures of held-out views are: PSNR and SSIM, whole or inside a mask, and a table of them.

use std::fmt;

use crate::Result;
use crate::loss::{area, check_image, empty_mask, ssim, unit};

/// A value of an image: a byte, or a number that is clamped to 0 to 1.
pub trait Sample: Copy + Send + Sync {
    /// As a number from 0 to 1.
    fn to_unit(self) -> f32;
}

impl Sample for u8 {
    fn to_unit(self) -> f32 {
        unit(self)
    }
}

impl Sample for f32 {
    fn to_unit(self) -> f32 {
        self.clamp(0.0, 1.0)
    }
}

/// How near a picture is to a photo.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Similarity {
    /// 10 log₁₀(1 / mean squared difference), dB; infinite for equal pictures.
    pub psnr: f64,
    /// Mean structural similarity ([`ssim`](mod@crate::loss::ssim)), at most 1.
    pub ssim: f64,
}

/// PSNR and SSIM of two pictures, row by row; with a mask (255 on the object, 0 elsewhere), means over its area, where
/// what is outside says nothing through the window of the SSIM either.
///
/// # Errors
/// If sizes differ or are zero, or the mask is zero everywhere.
pub fn similarity<A: Sample, B: Sample>(
    image: &[[A; 3]],
    target: &[[B; 3]],
    mask: Option<&[u8]>,
    width: usize,
    height: usize,
) -> Result<Similarity> {
    check_image("the picture to be measured", image.len(), width, height)?;
    check_image("the photo it is measured against", target.len(), width, height)?;
    check_image("the mask of a measure", mask.map_or(image.len(), <[u8]>::len), width, height)?;
    let area = mask.map_or(image.len() as f64, area);
    if area == 0.0 {
        return Err(empty_mask("a picture to be measured", "the mask is zero everywhere"));
    }
    let y: Vec<[f32; 3]> = target.iter().map(|rgb| rgb.map(Sample::to_unit)).collect();
    let mut x: Vec<[f32; 3]> = image.iter().map(|rgb| rgb.map(Sample::to_unit)).collect();
    let mut squares = 0.0;
    for (i, (x, y)) in x.iter_mut().zip(&y).enumerate() {
        let w = mask.map_or(1.0, |mask| unit(mask[i]));
        for k in 0..3 {
            squares += f64::from(w) * f64::from(x[k] - y[k]).powi(2);
            x[k] = w * x[k] + (1.0 - w) * y[k];
        }
    }
    let psnr = -10.0 * (squares / (3.0 * area)).log10();
    Ok(Similarity { psnr, ssim: ssim(&x, &y, mask, width, height)? })
}

/// [`similarity`]'s PSNR alone, dB.
///
/// # Errors
/// As [`similarity`].
pub fn psnr<A: Sample, B: Sample>(image: &[[A; 3]], target: &[[B; 3]]) -> Result<f64> {
    check_image("the photo a picture is measured against", target.len(), image.len(), 1)?;
    let square = |(a, b): (&[A; 3], &[B; 3])| -> f64 {
        (0..3).map(|k| f64::from(a[k].to_unit() - b[k].to_unit()).powi(2)).sum()
    };
    let squares: f64 = image.iter().zip(target).map(square).sum();
    Ok(-10.0 * (squares / (3.0 * image.len() as f64)).log10())
}

/// A row of a table.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Row {
    /// The view's name, for instance its photo.
    pub name: String,
    /// PSNR and SSIM.
    #[serde(flatten)]
    pub similarity: Similarity,
    /// Pixels that were compared; in the row of the mean, views.
    pub count: usize,
}

/// PSNR and SSIM of held-out views. Its `Display` is a text table that ends with the mean.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Table {
    /// The views.
    pub rows: Vec<Row>,
}

impl Table {
    /// Adds a view.
    pub fn push(&mut self, name: impl Into<String>, similarity: Similarity, count: usize) {
        self.rows.push(Row { name: name.into(), similarity, count });
    }

    /// Means of PSNR and SSIM over the views, and how many there are; `None` without views.
    pub fn mean(&self) -> Option<Row> {
        let count = self.rows.len();
        let mean = |value: fn(&Similarity) -> f64| {
            self.rows.iter().map(|row| value(&row.similarity)).sum::<f64>() / count as f64
        };
        let similarity = Similarity { psnr: mean(|s| s.psnr), ssim: mean(|s| s.ssim) };
        (count > 0).then(|| Row { name: "mean".into(), similarity, count })
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0).max("view".len());
        writeln!(f, "{:name$}  {:>8}  {:>7}  {:>9}", "view", "PSNR dB", "SSIM", "count")?;
        for row in self.rows.iter().chain(&self.mean()) {
            let Similarity { psnr, ssim } = row.similarity;
            writeln!(f, "{:name$}  {psnr:8.2}  {ssim:7.4}  {:9}", row.name, row.count)?;
        }
        Ok(())
    }
}
