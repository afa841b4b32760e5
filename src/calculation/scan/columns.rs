//! The flat arrays that hold a cloud's y and z. Kept as wide as the file gave them: single precision halves what a pass over a
//! large scan has to read.

use std::ops::Range;

/// The y and z of many points, mm; both of one length.
#[derive(Debug, Clone, PartialEq)]
pub enum Columns {
    /// From a file that holds single precision in millimetres.
    F32 {
        /// All y.
        y: Vec<f32>,
        /// All z.
        z: Vec<f32>,
    },
    /// From everything else.
    F64 {
        /// All y.
        y: Vec<f64>,
        /// All z.
        z: Vec<f64>,
    },
}

/// Neighbouring points of [`Columns`] as they are stored, mm; y and z are of one length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stretch<'a> {
    /// In single precision.
    F32 {
        /// Their y.
        y: &'a [f32],
        /// Their z.
        z: &'a [f32],
    },
    /// In double precision.
    F64 {
        /// Their y.
        y: &'a [f64],
        /// Their z.
        z: &'a [f64],
    },
}

impl Columns {
    /// The points of `range`; none where it reaches beyond the end.
    #[must_use]
    pub fn stretch(&self, range: Range<usize>) -> Stretch<'_> {
        match self {
            Self::F32 { y, z } => {
                Stretch::F32 { y: y.get(range.clone()).unwrap_or_default(), z: z.get(range).unwrap_or_default() }
            }
            Self::F64 { y, z } => {
                Stretch::F64 { y: y.get(range.clone()).unwrap_or_default(), z: z.get(range).unwrap_or_default() }
            }
        }
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::F32 { y, z } => y.len().min(z.len()),
            Self::F64 { y, z } => y.len().min(z.len()),
        }
    }

    /// Whether there is no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// (y, z) of one point in double precision.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<[f64; 2]> {
        match self {
            Self::F32 { y, z } => Some([f64::from(*y.get(index)?), f64::from(*z.get(index)?)]),
            Self::F64 { y, z } => Some([*y.get(index)?, *z.get(index)?]),
        }
    }

    /// The first point with a coordinate that is NaN or infinite.
    #[must_use]
    pub fn first_not_finite(&self) -> Option<usize> {
        let (y, z) = match self {
            Self::F32 { y, z } => (first_where(y, |v| !v.is_finite()), first_where(z, |v| !v.is_finite())),
            Self::F64 { y, z } => (first_not_finite(y), first_not_finite(z)),
        };
        y.into_iter().chain(z).min()
    }

    /// Copies `range` into `y` and `z`, cleared first; what lies beyond the end is left out.
    pub fn load(&self, range: Range<usize>, y: &mut Vec<f64>, z: &mut Vec<f64>) {
        y.clear();
        z.clear();
        match self {
            Self::F32 { y: ys, z: zs } => {
                y.extend(ys.get(range.clone()).unwrap_or_default().iter().map(|&v| f64::from(v)));
                z.extend(zs.get(range).unwrap_or_default().iter().map(|&v| f64::from(v)));
            }
            Self::F64 { y: ys, z: zs } => {
                y.extend_from_slice(ys.get(range.clone()).unwrap_or_default());
                z.extend_from_slice(zs.get(range).unwrap_or_default());
            }
        }
    }
}

/// The first value that is NaN or infinite.
pub(super) fn first_not_finite(values: &[f64]) -> Option<usize> {
    first_where(values, |v| !v.is_finite())
}

/// The first value that is `wrong`. Asks for whole blocks first, without a branch: a scan that is fine passes at the
/// speed of memory.
fn first_where<T: Copy>(values: &[T], wrong: impl Fn(T) -> bool) -> Option<usize> {
    const BLOCK: usize = 1024;
    let block = values.chunks(BLOCK).position(|block| block.iter().fold(false, |any, value| any | wrong(*value)))?;
    let start = block * BLOCK;
    let within = values.get(start..)?.iter().position(|value| wrong(*value))?;
    Some(start + within)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_several_wrong_points_is_found() {
        let mut y = vec![1.0; 5000];
        let mut z = y.clone();
        (y[4000], z[3000], z[3001]) = (f64::NAN, f64::INFINITY, f64::NAN);
        assert_eq!(Columns::F64 { y, z: z.clone() }.first_not_finite(), Some(3000));
        let columns = Columns::F32 { y: vec![0.0; 5000], z: vec![0.0; 5000] };
        assert_eq!(columns.first_not_finite(), None);
    }
}
