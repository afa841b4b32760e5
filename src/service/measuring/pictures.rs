//! Pictures of a measurement, or of one of its parts, drawn from the stored scan on request.

use super::order::Origin;
use super::points::{PointFile, Points};
use super::state::Measuring;
use crate::estimation::{Conditioning, Estimate, Outcome, Pose, Profile};
use crate::plot::{Picture, Subject, draw};
use crate::scan::decode::Limits;
use crate::scan::{Scan, Station};
use crate::service::error::ServiceError;

use super::pipeline::Decoded;
use super::recipe::Resolved;
use super::record::{Chosen, Measurement, PoseResult};

/// A scan and its result as pictures need them: in one frame, with one profile per station.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The profiles of the part, or of all parts if none is selected.
    pub scan: Scan,
    /// The result with its profiles; without profiles if they are not those of the scan.
    pub estimate: Estimate,
    /// Index of its first profile among those of the complete scan.
    pub first_profile: usize,
    /// Name of the part, if there are parts.
    pub part: Option<String>,
}

/// Type of a picture and the texts that it shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureRequest<'a> {
    /// The type.
    pub picture: Picture,
    /// The name of the measurement or of its file.
    pub name: &'a str,
    /// The name of the recipe.
    pub recipe: Option<&'a str>,
    /// The setting of the estimation.
    pub epsilon_mm: f64,
    /// Index, among all profiles of the scan, of the profile that a section shows.
    pub profile: Option<usize>,
}

impl Measurement {
    /// Draws a picture of a view of this measurement.
    #[must_use]
    pub fn draw(&self, view: &View, request: PictureRequest<'_>) -> String {
        let PictureRequest { picture, name, recipe, epsilon_mm, profile } = request;
        let title = view.part.as_ref().map_or_else(|| name.to_owned(), |part| format!("{name}, part {part}"));
        let subject = Subject {
            title: &title,
            measured_at: Some(self.created_at),
            recipe,
            software: Some(&self.software),
            epsilon_mm,
            profile: profile.map(|index| index.saturating_sub(view.first_profile)),
            first_profile: view.first_profile,
        };
        draw(picture, &view.scan, &view.estimate, &subject)
    }

    /// The view of the selected part; it always contains `profile` (an index in the complete scan).
    #[must_use]
    pub fn view(&self, scan: &Scan, profiles: &[Profile], chosen: Chosen<'_>, profile: Option<usize>) -> View {
        let all = 0..scan.stations().len();
        let (finding, stations, part) = match chosen {
            Chosen::Whole(finding) => (finding.clone(), all.clone(), None),
            Chosen::Part(part, _) => (part.finding.clone(), part.stations(), Some(part.name.clone())),
            Chosen::None(refusal) => {
                let (outcome, conditioning) = (Outcome::Refused(refusal.clone()), Conditioning::default());
                (PoseResult { outcome, conditioning, residuals: None }, all.clone(), None)
            }
        };
        let (stations, part) = match profile {
            // A profile outside every part can only be shown among all profiles.
            Some(index) if !stations.contains(&index) => (all.clone(), None),
            _ => (stations, part),
        };
        // The same applies to a window that contains no profile.
        let (scan, stations) = match scan.part(stations.clone()) {
            Some(part) => (part, stations),
            None => (scan.clone(), all.clone()),
        };
        let first_profile = stations.start;
        // Sections that were cut along the axis differ from the profiles of the scan, also in number.
        let profiles = if stations == all { profiles } else { profiles.get(stations).unwrap_or_default() };
        let PoseResult { outcome, conditioning, residuals } = finding;
        let (scan, outcome, profiles) = in_one_frame(scan, outcome, profiles);
        let estimate = Estimate { method: self.method, outcome, profiles, conditioning, residuals };
        View { scan, estimate, first_profile, part }
    }

    /// The views of all parts, or of the complete scan if there are none.
    #[must_use]
    pub fn views(&self, scan: &Scan, profiles: &[Profile]) -> Vec<View> {
        let chosen: Vec<Chosen<'_>> = match self.result.parts() {
            Some(parts) if !parts.is_empty() => {
                parts.iter().enumerate().map(|(index, part)| Chosen::Part(part, index + 1)).collect()
            }
            _ => self.result.choose(None).into_iter().collect(),
        };
        chosen.into_iter().map(|chosen| self.view(scan, profiles, chosen, None)).collect()
    }
}

/// Transforms the points, the pose and the profiles to one frame: that of the scan, or that of the sections that were cut along
/// the axis.
fn in_one_frame(scan: Scan, outcome: Outcome, profiles: &[Profile]) -> (Scan, Outcome, Vec<Profile>) {
    let pose = match &outcome {
        Outcome::Accepted(pose) => pose,
        // A scan may be refused after sections were cut from it. Their frame is not stored, so the scan is shown in its own frame.
        Outcome::Refused(_) if are_of(profiles, &scan) => return (scan, outcome, profiles.to_vec()),
        Outcome::Refused(_) => return (scan, outcome, Vec::new()),
    };
    let Some(cut) = pose.cut else { return (scan, outcome, profiles.to_vec()) };
    let sections = cut.apply(&scan);
    if let Some(sections) = sections.as_ref().filter(|sections| are_of(profiles, sections)) {
        return (sections.clone(), outcome, profiles.to_vec());
    }
    // `least_squares` uses the points directly and cuts no sections, but its pose is in a frame along the axis as well.
    match (pose.on_rail(), sections) {
        (Some(found), _) => {
            let (axis, x_ref, uncertainty) = (found.axis, found.x_ref, found.uncertainty);
            let placed = Pose { axis, x_ref, uncertainty, cut: None, ..(**pose).clone() };
            (scan, Outcome::Accepted(Box::new(placed)), profiles.to_vec())
        }
        (None, Some(sections)) => {
            let profiles = sections.stations().iter().map(without_verdict).collect();
            (sections, outcome, profiles)
        }
        (None, None) => (scan, outcome, Vec::new()),
    }
}

/// Whether these are the profiles of this scan.
fn are_of(profiles: &[Profile], scan: &Scan) -> bool {
    let same =
        |(profile, station): (&Profile, &Station)| (profile.x - station.x).abs() <= 1e-9 * (1.0 + station.x.abs());
    profiles.len() == scan.stations().len() && profiles.iter().zip(scan.stations()).all(same)
}

/// A profile all of whose points are inliers.
fn without_verdict(station: &Station) -> Profile {
    let points_count = station.end - station.start;
    Profile { x: station.x, points_count, rejected: None, section: None, offset: None }
}

struct Wanted {
    measurement: Measurement,
    profiles: Vec<Profile>,
    resolved: Resolved,
    picture: Picture,
    part: Option<String>,
    profile: Option<usize>,
}

impl Wanted {
    fn draw(self, decoded: Decoded, limits: &Limits) -> Result<String, ServiceError> {
        let Self { measurement, profiles, resolved, picture, part, profile } = self;
        let prepared = super::pipeline::cut(decoded, &resolved, limits)?;
        let chosen = measurement.result.choose(part.as_deref())?;
        let view = measurement.view(&prepared.scan, &profiles, chosen, profile);
        let (name, recipe) = (&measurement.id, measurement.recipe_name.as_deref());
        let epsilon_mm = resolved.settings.epsilon_mm;
        Ok(measurement.draw(&view, PictureRequest { picture, name, recipe, epsilon_mm, profile }))
    }
}

impl Measuring {
    /// Draws a picture of a measurement, or of a part of it; `profile` is the index of the profile that a section shows.
    ///
    /// # Errors
    /// [`ServiceError::PartUnknown`], [`ServiceError::ProfileUnknown`],
    /// [`ServiceError::ScanFileMissing`], [`ServiceError::Compute`] if the queue of pictures is full.
    pub async fn picture(
        &self,
        measurement: Measurement,
        picture: Picture,
        part: Option<String>,
        profile: Option<u64>,
    ) -> Result<String, ServiceError> {
        let profiles_count = measurement.counts.total_count;
        if let Some(index) = profile.filter(|index| *index >= profiles_count) {
            return Err(ServiceError::ProfileUnknown { index, profiles_count });
        }
        let profile = profile.and_then(|index| usize::try_from(index).ok());
        let of_profile = || measurement.result.part_of_profile(profile?).map(str::to_owned);
        let part = part.or_else(of_profile);
        measurement.result.choose(part.as_deref())?;
        // The place is taken before the profiles and the file are read, which takes memory and time.
        let queued = self.drawing.take_place()?;
        let profiles = self.profiles(&measurement.id).await?;
        let resolved = measurement.recipe.resolve(&self.shared.defaults)?;
        let file = self.scan_file(&measurement.scan_id()).await?;
        let points = Points::InFile(Box::new(PointFile {
            bytes_count: file.metadata().map_or(0, |metadata| metadata.len()),
            file,
            points_count: Some(measurement.points_count),
            sent: None,
            origin: Origin { parameter: Some(measurement.format), ..Origin::default() },
            resolved: resolved.clone(),
        }));
        let limits = self.shared.capacity.scan.clone();
        let wanted = Wanted { measurement, profiles, resolved, picture, part, profile };
        self.with_points((&self.drawing, queued), points, move |decoded, _| wanted.draw(decoded, &limits)).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::{Method, Progress, Refusal, Settings, estimate};
    use crate::scan::synthetic::{Part, make};
    use crate::scan::{Columns, Grouping};

    fn by(scan: &Scan, method: Method) -> Estimate {
        estimate(scan, &Settings { method, ..Settings::default() }, &Progress::default())
    }

    fn scan() -> Scan {
        make(&Part { profiles_count: 60, points_count: 120, ..Part::smooth(3) }).expect("a scan").0
    }

    /// The same points with z along the part.
    fn upright() -> Scan {
        let points: Vec<[f64; 3]> = scan().every_nth_point(1).collect();
        let columns = Columns::F64 {
            y: points.iter().map(|[_, y, _]| *y).collect(),
            z: points.iter().map(|[x, ..]| *x).collect(),
        };
        let station = Station { x: 0.0, start: 0, end: points.len() };
        let scan = Scan::new(vec![station], columns, "one".to_owned()).expect("a scan");
        let own_x = points.iter().map(|[_, _, z]| *z).collect();
        scan.with_own_x(own_x).expect("finite").with_grouping(Grouping::Chosen)
    }

    /// Largest distance of a point from the surface of the pose, mm.
    fn off_surface(scan: &Scan, outcome: &Outcome) -> f64 {
        let Outcome::Accepted(pose) = outcome else { panic!("accepted") };
        let off = scan.every_nth_point(1).map(|point| (pose.axis.distance(point) - pose.radius).abs());
        off.fold(0.0, f64::max)
    }

    #[test]
    fn a_pose_is_shown_in_the_frame_of_the_points_for_every_method_and_direction() {
        for (scan, on_rail) in [(scan(), true), (upright(), false)] {
            for method in [Method::Cylinder, Method::LeastSquares] {
                let Estimate { outcome, profiles, .. } = by(&scan, method);
                let (shown, outcome, profiles) = in_one_frame(scan.clone(), outcome, &profiles);
                assert!(off_surface(&shown, &outcome) < 0.5, "{method:?} {on_rail}");
                assert!(are_of(&profiles, &shown), "{method:?} {on_rail}");
                assert_eq!(shown == scan, on_rail, "{method:?}");
            }
        }
    }

    #[test]
    fn profiles_of_sections_cut_before_a_refusal_are_not_mistaken_for_those_of_the_scan() {
        let scan = upright();
        let profiles = by(&scan, Method::Cylinder).profiles;
        assert!(profiles.len() > 1);
        let refused = Outcome::Refused(Refusal::NoCylinder { nominal_radius_mm: None });
        let (shown, _, kept) = in_one_frame(scan.clone(), refused.clone(), &profiles);
        assert!(shown == scan && kept.is_empty());
        let own = vec![without_verdict(&scan.stations()[0])];
        assert_eq!(in_one_frame(scan, refused, &own).2, own);
    }
}
