//! Asks the kernel for huge pages where a column is large: filling fresh memory 4 KiB at a time costs more than reading a
//! whole scan, 2 MiB at a time a tenth of that. A hint: where it is not taken, everything works as before, slower.
//! Must not know what lies in the memory.

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

fn advise<T>(column: &mut Vec<T>) {
    let bytes_count = column.capacity() * size_of::<T>();
    if bytes_count < LEAST_BYTES {
        return;
    }
    let start = column.as_mut_ptr().cast::<u8>();
    let skipped = start.align_offset(PAGE_BYTES);
    let whole = bytes_count.saturating_sub(skipped) / PAGE_BYTES * PAGE_BYTES;
    // SAFETY: the range lies within the column's own allocation, since `skipped` + `whole` is at most its size, and this
    // advice changes neither contents nor access, only how the pages are backed. A kernel without huge pages refuses it,
    // and nothing depends on that.
    #[expect(unsafe_code, reason = "the standard library has no safe way to say this")]
    let _taken = unsafe { madvise(start.wrapping_add(skipped).cast(), whole, Advice::LinuxHugepage) };
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
