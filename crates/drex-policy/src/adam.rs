//! Adam (Kingma and Ba 2015, algorithm 1) on plain arrays, so that its state is ours to save and independent of the tensor library.

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// Running moments of the gradients.
#[derive(Debug, Clone)]
pub(crate) struct Adam {
    first: Vec<Vec<f32>>,
    second: Vec<Vec<f32>>,
    steps: i32,
}

impl Adam {
    /// At rest, for arrays as long as `like`.
    pub fn new(like: &[Vec<f32>]) -> Self {
        let zeros: Vec<Vec<f32>> = like.iter().map(|a| vec![0.0; a.len()]).collect();
        Self { first: zeros.clone(), second: zeros, steps: 0 }
    }

    /// First and second moments and the number of steps, to be saved.
    pub fn state(&self) -> (&[Vec<f32>], &[Vec<f32>], i32) {
        (&self.first, &self.second, self.steps)
    }

    /// Goes on from [`state`](Self::state).
    pub fn from_state(first: Vec<Vec<f32>>, second: Vec<Vec<f32>>, steps: i32) -> Self {
        Self { first, second, steps }
    }

    /// Moves `values` one step against `gradients`.
    pub fn step(&mut self, values: &mut [Vec<f32>], gradients: &[Vec<f32>], learning_rate: f64) {
        self.steps = self.steps.saturating_add(1);
        let rate = learning_rate * (1.0 - BETA2.powi(self.steps)).sqrt() / (1.0 - BETA1.powi(self.steps));
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((values, gradients), (first, second)) in values.iter_mut().zip(gradients).zip(moments) {
            let moments = first.iter_mut().zip(second);
            for ((value, gradient), (m, v)) in values.iter_mut().zip(gradients).zip(moments) {
                *m = BETA1 as f32 * *m + (1.0 - BETA1) as f32 * gradient;
                *v = BETA2 as f32 * *v + (1.0 - BETA2) as f32 * gradient * gradient;
                *value -= rate as f32 * *m / (v.sqrt() + EPSILON as f32);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_length_of_the_learning_rate() {
        // After one step the bias-corrected moments are g and g²: the step is the learning rate times the sign of g.
        let mut values = vec![vec![1.0, 1.0]];
        let mut adam = Adam::new(&values);
        adam.step(&mut values, &[vec![3.0, -0.02]], 0.1);
        assert!((values[0][0] - 0.9).abs() < 1e-5 && (values[0][1] - 1.1).abs() < 1e-4, "{values:?}");
    }

    #[test]
    fn finds_the_minimum_of_a_parabola() {
        let mut values = vec![vec![5.0]];
        let mut adam = Adam::new(&values);
        for _ in 0..2000 {
            let gradient = vec![vec![2.0 * (values[0][0] - 1.5)]];
            adam.step(&mut values, &gradient, 0.02);
        }
        assert!((values[0][0] - 1.5).abs() < 1e-3, "{values:?}");
    }
}
