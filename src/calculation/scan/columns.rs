//! The flat arrays of the y and z of a cloud, in the precision of the file: single precision halves the memory that a pass over a
//! large scan has to read.
//!
//! Large columns request huge pages from the kernel: filling fresh memory 4 KiB at a time costs more than reading a complete scan,
//! 2 MiB at a time a tenth of that. The request is a hint: if the kernel ignores it, the result is the same but slower.

use rustix::mm::{Advice, madvise};
use std::ops::Range;

/// The y and z of many points, mm; both have the same length.
#[derive(Debug, Clone, PartialEq)]
pub enum Columns {
    /// From a file in single precision and in millimetres.
    F32 {
        /// All y.
        y: Vec<f32>,
        /// All z.
        z: Vec<f32>,
    },
    /// From every other file.
    F64 {
        /// All y.
        y: Vec<f64>,
        /// All z.
        z: Vec<f64>,
    },
}

/// Neighbouring points of [`Columns`] in their stored precision, mm; y and z have the same length.
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
    /// The points of `range`; none if it extends beyond the end.
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

    /// Copies `range` into `y` and `z`, which are cleared first; points beyond the end are omitted.
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

/// The first value that is `wrong`. Complete blocks are tested first without a branch, so that a valid scan passes at the speed of
/// memory.
fn first_where<T: Copy>(values: &[T], wrong: impl Fn(T) -> bool) -> Option<usize> {
    const BLOCK: usize = 1024;
    let block = values.chunks(BLOCK).position(|block| block.iter().fold(false, |any, value| any | wrong(*value)))?;
    let start = block * BLOCK;
    let within = values.get(start..)?.iter().position(|value| wrong(*value))?;
    Some(start + within)
}

/// Smaller columns do not benefit.
const LEAST_BYTES: usize = 4 << 20;
const PAGE_BYTES: usize = 4096;

/// Reserves space for `more` elements, backed by huge pages if worthwhile.
pub(super) fn reserve<T>(column: &mut Vec<T>, more: usize) {
    let before = column.capacity();
    column.reserve(more);
    if column.capacity() != before {
        advise(column);
    }
}

/// A vector of zeros; its memory is touched when it is filled, by the thread that fills it.
pub(crate) fn zeroed<T: Copy + Default>(count: usize) -> Vec<T> {
    let mut column = vec![T::default(); count];
    advise(&mut column);
    column
}

fn advise<T>(column: &mut Vec<T>) {
    let bytes_count = column.capacity() * size_of::<T>();
    if bytes_count < LEAST_BYTES {
        return;
    }
    let start = column.as_mut_ptr().cast::<u8>();
    // The advice covers the first to the last page, including bytes outside the column: a large allocation owns its pages, and one
    // with different kinds of pages could not grow without a copy.
    let before = start.addr() % PAGE_BYTES;
    let whole = (before + bytes_count).next_multiple_of(PAGE_BYTES);
    // SAFETY: every page of the range contains a byte of the column's own allocation, so all of them are mapped. The advice changes
    // neither contents nor access, only how the pages are backed. A kernel without huge pages returns an error, on which nothing
    // depends.
    #[expect(unsafe_code, reason = "the standard library has no safe function for this advice")]
    let _taken = unsafe { madvise(start.wrapping_sub(before).cast(), whole, Advice::LinuxHugepage) };
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

#[cfg(test)]
mod huge_pages_tests {
    use super::*;

    #[test]
    fn a_column_keeps_its_contents_and_gets_its_capacity() {
        for count in [0_usize, 10, 3_000_000] {
            let mut column: Vec<f32> = (0..count).map(|i| i as f32).collect();
            reserve(&mut column, 2_000_000);
            assert!(column.capacity() >= count + 2_000_000);
            assert!(column.iter().enumerate().all(|(i, v)| *v == i as f32));
        }
    }
}
