//! Asks the kernel for huge pages where a column is large: filling fresh memory 4 KiB at a time costs more than reading a whole
//! scan, 2 MiB at a time a tenth of that. A hint: where it is not taken, everything works as before, slower.

use rustix::mm::{Advice, madvise};

/// Smaller columns gain nothing.
const LEAST_BYTES: usize = 4 << 20;
const PAGE_BYTES: usize = 4096;

/// Makes room for `more` elements, backed by huge pages where that pays.
pub(super) fn reserve<T>(column: &mut Vec<T>, more: usize) {
    let before = column.capacity();
    column.reserve(more);
    if column.capacity() != before {
        advise(column);
    }
}

/// So many zeros; the memory is touched where it is filled, by whatever thread does that.
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
    // From the first page to the last one, the column's or not: a large allocation has its pages for itself, and one whose
    // pages are not all alike could not grow without being copied.
    let before = start.addr() % PAGE_BYTES;
    let whole = (before + bytes_count).next_multiple_of(PAGE_BYTES);
    // SAFETY: every page of the range holds a byte of the column's own allocation, so all of them are mapped, and this
    // advice changes neither contents nor access, only how the pages are backed. A kernel without huge pages refuses it,
    // and nothing depends on that.
    #[expect(unsafe_code, reason = "the standard library has no safe way to say this")]
    let _taken = unsafe { madvise(start.wrapping_sub(before).cast(), whole, Advice::LinuxHugepage) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_keeps_its_contents_and_gets_its_room() {
        for count in [0_usize, 10, 3_000_000] {
            let mut column: Vec<f32> = (0..count).map(|i| i as f32).collect();
            reserve(&mut column, 2_000_000);
            assert!(column.capacity() >= count + 2_000_000);
            assert!(column.iter().enumerate().all(|(i, v)| *v == i as f32));
        }
    }
}
