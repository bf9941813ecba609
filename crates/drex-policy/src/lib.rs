//! A grasp policy conditioned on mass, with its force in newtons.
