//! Rank statistics and a small logistic regression. Deterministic; no dependency.

/// Area under the ROC curve of `scores` for `labels`; ties count half.
pub fn auc(scores: &[f64], labels: &[bool]) -> f64 {
    let ranks = ranks(scores);
    let positives = labels.iter().filter(|l| **l).count() as f64;
    let negatives = labels.len() as f64 - positives;
    let sum: f64 = ranks.iter().zip(labels).filter(|(_, l)| **l).map(|(r, _)| r + 1.0).sum();
    (sum - positives * (positives + 1.0) / 2.0) / (positives * negatives)
}

/// Spearman's rank correlation.
pub fn spearman(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() as f64 - 1.0) / 2.0;
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>();
    dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt()
}

/// Ranks from zero, ties share their mean.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut ranks = vec![0.0; values.len()];
    let mut start = 0;
    while start < order.len() {
        let end = (start..order.len()).find(|&k| values[order[k]] != values[order[start]]).unwrap_or(order.len());
        for &i in &order[start..end] {
            ranks[i] = (start + end - 1) as f64 / 2.0;
        }
        start = end;
    }
    ranks
}

/// Logistic regression on standardised features with an L2 penalty, by Newton's method.
pub struct Logistic {
    mean: Vec<f64>,
    scale: Vec<f64>,
    /// One weight per standardised feature, the bias last.
    pub weights: Vec<f64>,
}

impl Logistic {
    /// Fits rows of features to labels; `penalty` in units of samples per unit weight squared.
    pub fn fit(rows: &[&[f64]], labels: &[bool], penalty: f64) -> Self {
        let d = rows[0].len();
        let n = rows.len() as f64;
        let mean: Vec<f64> = (0..d).map(|k| rows.iter().map(|r| r[k]).sum::<f64>() / n).collect();
        let spread = |k: usize| (rows.iter().map(|r| (r[k] - mean[k]).powi(2)).sum::<f64>() / n).sqrt();
        let scale = (0..d).map(|k| spread(k).max(1e-9)).collect();
        let mut model = Self { mean, scale, weights: vec![0.0; d + 1] };
        let x: Vec<Vec<f64>> = rows.iter().map(|r| model.standardised(r)).collect();
        for _ in 0..12 {
            let mut h = nalgebra::DMatrix::<f64>::identity(d + 1, d + 1) * penalty;
            h[(d, d)] = 1e-9;
            let mut g = -nalgebra::DVector::from_column_slice(&model.weights) * penalty;
            g[d] = 0.0;
            for (x, label) in x.iter().zip(labels) {
                let p = model.probability(x);
                let residual = f64::from(u8::from(*label)) - p;
                for i in 0..=d {
                    g[i] += residual * x[i];
                    for j in 0..=d {
                        h[(i, j)] += p * (1.0 - p) * x[i] * x[j];
                    }
                }
            }
            let Some(step) = h.cholesky().map(|c| c.solve(&g)) else { break };
            model.weights.iter_mut().zip(step.iter()).for_each(|(w, s)| *w += s);
            if step.norm() < 1e-9 {
                break;
            }
        }
        model
    }

    /// The log of the odds of success.
    pub fn score(&self, row: &[f64]) -> f64 {
        self.standardised(row).iter().zip(&self.weights).map(|(x, w)| x * w).sum()
    }

    fn standardised(&self, row: &[f64]) -> Vec<f64> {
        let mut x: Vec<f64> =
            (0..row.len()).map(|k| ((row[k] - self.mean[k]) / self.scale[k]).clamp(-4.0, 4.0)).collect();
        x.push(1.0);
        x
    }

    fn probability(&self, x: &[f64]) -> f64 {
        1.0 / (1.0 + (-x.iter().zip(&self.weights).map(|(x, w)| x * w).sum::<f64>()).exp())
    }
}
