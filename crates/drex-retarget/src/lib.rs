//! Human hand poses to robot hands, aware of the object.
