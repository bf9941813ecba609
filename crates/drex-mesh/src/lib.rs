//! Sim-ready assets from meshes: repair, convex pieces, mass properties, signed distance, MJCF.
