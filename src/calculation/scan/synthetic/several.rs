//! Synthetic parts one behind the other in one scan.

use super::Part;
use super::acquire::make;
use super::truth::Truth;
use crate::scan::columns::Columns;
use crate::scan::{Scan, ScanError, Station};

/// Scans parts that stand one behind the other; the truth of each, in their order. A part's profiles are those that [`make`]
/// makes of it alone, to the bit.
///
/// # Errors
/// [`ScanError`] where a part cannot be made, or does not lie behind the one before it.
pub fn make_several(parts: &[Part]) -> Result<(Scan, Vec<Truth>), ScanError> {
    let (mut y, mut z, mut stations, mut truths) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut blanks, mut own_x, mut is_planar) = (Vec::new(), Vec::new(), true);
    for part in parts {
        let (scan, truth) = make(part)?;
        let before = y.len();
        stations.extend(scan.stations().iter().map(|station| Station {
            start: station.start + before,
            end: station.end + before,
            ..*station
        }));
        let (mut part_y, mut part_z) = (Vec::new(), Vec::new());
        scan.columns().load(scan.points(), &mut part_y, &mut part_z);
        own_x.extend(scan.stations().iter().flat_map(|station| scan.points_of(station)).map(|[x, ..]| x));
        is_planar &= scan.is_planar();
        y.append(&mut part_y);
        z.append(&mut part_z);
        blanks.extend_from_slice(scan.blanks());
        truths.push(truth);
    }
    let scan = Scan::new(stations, Columns::F64 { y, z }, "synthetic".to_owned())?;
    let scan = scan.with_blanks(blanks);
    Ok((if is_planar { scan } else { scan.with_own_x(own_x)? }, truths))
}
