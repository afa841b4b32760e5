//! From a scan to the pose of the part's axis.
