//! A cloud as a file that reads back as the same cloud: binary PLY, with the profile of every point where the cloud has
//! profiles.

use crate::scan::cloud::{Cloud, Labels};
use crate::scan::columns::Columns;
use std::io::{self, Write};

/// Writes a cloud in the order of its points. What reads it finds the same points, and the same profiles, so whatever is
/// measured from either is the same; missing points are not written.
///
/// # Errors
/// Those of `out`.
pub fn encode_cloud(cloud: &Cloud, out: &mut dyn Write) -> io::Result<()> {
    let exact = |value: f64| f64::from(value as f32) == value;
    let single = matches!(cloud.columns, Columns::F32 { .. }) && cloud.stripes.iter().all(|stripe| exact(stripe.x));
    let kind = if single { "float" } else { "double" };
    let points_count = cloud.columns.len();
    write!(out, "ply\nformat binary_little_endian 1.0\ncomment unit: mm\nelement vertex {points_count}\n")?;
    ["x", "y", "z"].iter().try_for_each(|axis| writeln!(out, "property {kind} {axis}"))?;
    let labelled = match &cloud.labels {
        Labels::Column(name) => {
            writeln!(out, "property double {name}")?;
            true
        }
        Labels::None | Labels::Row => false,
    };
    writeln!(out, "end_header")?;
    let mut start = 0;
    for stripe in &cloud.stripes {
        for index in start..stripe.end {
            let Some([y, z]) = cloud.columns.get(index) else { return Ok(()) };
            match single {
                true => [stripe.x, y, z].iter().try_for_each(|value| out.write_all(&(*value as f32).to_le_bytes()))?,
                false => [stripe.x, y, z].iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))?,
            }
            if labelled {
                out.write_all(&stripe.label.to_le_bytes())?;
            }
        }
        start = stripe.end;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Stripe;
    use crate::scan::decode::{Format, Limits, Request, Unit, decode};

    #[test]
    fn a_cloud_reads_back_as_itself() {
        let stripe = |label, x, end| Stripe { label, x, end };
        let mut cloud = Cloud {
            stripes: vec![stripe(3.0, 0.5, 2), stripe(4.0, 0.25, 3)],
            columns: Columns::F32 { y: vec![1.5, -2.25, 3.0], z: vec![0.1, 200.0, -7.0] },
            labels: Labels::Column("profile".to_owned()),
            unit: Unit::Millimetre,
            blanks: Vec::new(),
            missing_count: 0,
        };
        for x in [0.25, 0.1] {
            cloud.stripes[1].x = x;
            let mut bytes = Vec::new();
            encode_cloud(&cloud, &mut bytes).expect("memory takes it");
            let limits = Limits::default();
            let request = Request::new(&limits);
            let read = decode(Format::Ply, &mut &*bytes, &request).expect("it reads");
            assert_eq!((&read.stripes, &read.labels), (&cloud.stripes, &cloud.labels));
            let points = |cloud: &Cloud| (0..3).map(|index| cloud.columns.get(index)).collect::<Vec<_>>();
            assert_eq!(points(&read), points(&cloud));
        }
    }
}
