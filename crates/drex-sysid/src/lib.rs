//! The mass of an object from a recorded push: estimate, interval, verdict.
