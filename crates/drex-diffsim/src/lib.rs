//! Differentiable rigid-body simulation with contact and friction, on dual numbers.
