//! Robot models from URDF and MJCF: kinematics, Jacobians, mass matrix; bundled LEAP and Allegro hands.
