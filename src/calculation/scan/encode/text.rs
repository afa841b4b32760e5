//! The text formats that a scan is written in.

use super::longest;
use crate::scan::Scan;
use std::io::{self, Write};

/// One row per point.
pub(super) fn write_csv(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "profile,x_mm,y_mm,z_mm")?;
    for (profile, station) in scan.stations().iter().enumerate() {
        for [x, y, z] in scan.points_of(station) {
            writeln!(out, "{profile},{x:?},{y:?},{z:?}")?;
        }
    }
    let stations_count = scan.stations().len();
    scan.blanks().iter().enumerate().try_for_each(|(blank, x)| writeln!(out, "{},{x:?},,", stations_count + blank))
}

/// One object per profile.
pub(super) fn write_json(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    write!(out, "{{\"profiles\":[")?;
    for (profile, station) in scan.stations().iter().enumerate() {
        let comma = if profile == 0 { "" } else { "," };
        write!(out, "{comma}\n{{\"x_mm\":{:?},\"points\":[", station.x)?;
        for (point, [_, y, z]) in scan.points_of(station).enumerate() {
            let comma = if point == 0 { "" } else { "," };
            write!(out, "{comma}[{y:?},{z:?}]")?;
        }
        write!(out, "]}}")?;
    }
    for x in scan.blanks() {
        write!(out, ",\n{{\"x_mm\":{x:?},\"points\":[]}}")?;
    }
    writeln!(out, "]}}")
}

/// Two rows per profile: the sensor's X is y, its Z is z, the frame's Y is x.
pub(super) fn write_gocator_csv(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    let columns = longest(scan);
    writeln!(out, "Info\nCSV Version,Sensor Count\n2,1\nEnd\n")?;
    writeln!(out, "RawProfile\nFrame Count,Column Count\n{},{columns}\n", scan.stations().len() + scan.blanks().len())?;
    write!(out, "Frame,Source,Time,Encoder,Z Encoder,Inputs,Exposure,Y,Axis")?;
    (0..columns).try_for_each(|column| write!(out, ",{column}"))?;
    writeln!(out)?;
    for (frame, station) in scan.stations().iter().enumerate() {
        for (axis, name) in ["X", "Z"].into_iter().enumerate() {
            write!(out, "{frame},0,0,0,0,0,0,{:?},{name}", station.x)?;
            for [_, y, z] in scan.points_of(station) {
                write!(out, ",{:?}", if axis == 0 { y } else { z })?;
            }
            let filled = station.end - station.start;
            writeln!(out, "{}", ",".repeat(columns - filled))?;
        }
    }
    for (blank, x) in scan.blanks().iter().enumerate() {
        let frame = scan.stations().len() + blank;
        for name in ["X", "Z"] {
            writeln!(out, "{frame},0,0,0,0,0,0,{x:?},{name}{}", ",".repeat(columns))?;
        }
    }
    writeln!(out, "End")
}
