//! Contacts between a hand and an object: grasp map, force closure, the smallest squeeze.
