//! The pure machine against a small model of it.
