//! Pictures of recorded measurements, drawn anew from the kept scan.

use super::Service;
use super::error::ServiceError;
use super::measure::Decoded;
use super::measurement::Measurement;
use super::points::{PointFile, Points};
use super::recipe::Resolved;
use super::scans::Origin;
use super::view::PictureRequest;
use crate::estimation::Profile;
use crate::plot::Picture;
use crate::scan::decode::Limits;

impl Service {
    /// Draws a picture of a measurement, or of a part of it; `profile` is the index of the one that a section shows.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementUnknown`], [`ServiceError::PartUnknown`], [`ServiceError::ProfileUnknown`],
    /// [`ServiceError::ScanFileMissing`], [`ServiceError::Compute`] where as many pictures wait as may.
    pub async fn picture(
        &self,
        id: &str,
        picture: Picture,
        part: Option<String>,
        profile: Option<u64>,
    ) -> Result<String, ServiceError> {
        let measurement = self.measurement(id).await?;
        let profiles_count = measurement.tally.total_count;
        if let Some(index) = profile.filter(|index| *index >= profiles_count) {
            return Err(ServiceError::ProfileUnknown { index, profiles_count });
        }
        let profile = profile.and_then(|index| usize::try_from(index).ok());
        let of_profile = || measurement.findings.part_of_profile(profile?).map(str::to_owned);
        let part = part.or_else(of_profile);
        measurement.findings.choose(part.as_deref())?;
        // Before its profiles and its file are read, which take memory and time.
        let queued = self.drawing.take_place()?;
        let profiles = self.profiles(id).await?;
        let resolved = measurement.recipe.resolve(&self.defaults)?;
        let file = self.scan_file(&measurement.scan_id()).await?;
        let points = Points::InFile(Box::new(PointFile {
            bytes_count: file.metadata().map_or(0, |metadata| metadata.len()),
            file,
            points_count: Some(measurement.points_count),
            sent: None,
            origin: Origin { parameter: Some(measurement.format), ..Origin::default() },
            resolved: resolved.clone(),
        }));
        let limits = self.capacity.scan.clone();
        let wanted = Wanted { measurement, profiles, resolved, picture, part, profile };
        self.with_points((&self.drawing, queued), points, move |decoded, _| wanted.draw(decoded, &limits)).await
    }
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
        let prepared = super::measure::cut(decoded, &resolved, limits)?;
        let chosen = measurement.findings.choose(part.as_deref())?;
        let view = measurement.view(&prepared.scan, &profiles, chosen, profile);
        let (name, recipe) = (&measurement.id, measurement.recipe_name.as_deref());
        let epsilon_mm = resolved.settings.epsilon_mm;
        Ok(measurement.draw(&view, PictureRequest { picture, name, recipe, epsilon_mm, profile }))
    }
}
