//! Trees against an independent implementation, closed forms, finite differences and conservation.
