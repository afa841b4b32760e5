//! How far the part goes on without a gap. What lies beyond a gap is something else. Must not know cells or columns.

use super::evidence::Evidence;

/// A bin in which less than this share shows the part is void.
const SHARE_MIN: f64 = 0.1;
/// A bin with less evidence says nothing.
const EVIDENCE_MIN: usize = 4;
/// Void bins that may be a lost profile, and those that may be lost profiles or a gap; more of them are a gap.
const LOST_BINS: usize = 1;
const LOST_BINS_MAX: usize = 3;

/// How far the part goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    /// End of the last bin that shows the part, mm.
    pub(super) last: f64,
    /// Where something begins beyond the gap; infinite where nothing does.
    pub(super) next: f64,
}

/// `None` where nothing shows the part, or nobody can say whether profiles are lost or it ends and something else begins.
pub(super) fn reach(evidence: &[Evidence], from: f64, bin: f64) -> Option<Reach> {
    let mut bins: Vec<(f64, bool)> =
        evidence.iter().filter(|e| e.t >= from).map(|e| (((e.t - from) / bin).floor(), e.present)).collect();
    bins.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let (mut last, mut void_count) = (None, 0);
    for of_bin in bins.chunk_by(|(a, _), (b, _)| a == b).filter(|of_bin| of_bin.len() >= EVIDENCE_MIN) {
        let start = from + bin * of_bin.first()?.0;
        let present_count = of_bin.iter().filter(|(_, present)| *present).count();
        if (present_count as f64) < SHARE_MIN * of_bin.len() as f64 {
            void_count += 1;
            continue;
        }
        if let Some(last) = last.filter(|_| void_count > LOST_BINS) {
            return (void_count > LOST_BINS_MAX).then_some(Reach { last, next: start });
        }
        (last, void_count) = (Some(start + bin), 0);
    }
    last.map(|last| Reach { last, next: f64::INFINITY })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A profile a millimetre of five cells, showing the part where `shown` says so.
    fn planes(shown: &str) -> Vec<Evidence> {
        let plane = |(index, shown): (usize, char)| {
            let cell = Evidence {
                t: index as f64 + 0.5,
                present: shown == '#',
                lacking: None,
                variance: 0.0,
                column: 0,
                rising: true,
            };
            std::iter::repeat_n(cell, 5)
        };
        shown.chars().enumerate().flat_map(plane).collect()
    }

    #[test]
    fn a_lost_profile_is_no_gap_four_are_and_nobody_can_say_of_two_or_three() {
        let reach = |shown| reach(&planes(shown), 0.0, 1.0);
        assert_eq!(reach("####.###....##"), Some(Reach { last: 8.0, next: 12.0 }));
        assert_eq!(reach("####.###..."), Some(Reach { last: 8.0, next: f64::INFINITY }));
        assert_eq!(reach("####.###..##"), None);
        assert_eq!(reach("####.###...##"), None);
        assert_eq!(reach("....."), None);
    }
}
