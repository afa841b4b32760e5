//! Pictures of recorded measurements, drawn anew from the kept scan. Must not know how a picture looks.

use super::{Measurement, Origin, Resolved, Service, ServiceError};
use crate::estimation::Profile;
use crate::plot::{Picture, Subject, draw};
use crate::scan::decode::Limits;
use std::fs::File;
use std::io::BufReader;

impl Service {
    /// Draws a picture of a measurement; `profile` is the index of the one that a section shows.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementUnknown`], [`ServiceError::ProfileUnknown`], [`ServiceError::ScanFileMissing`],
    /// [`ServiceError::Compute`] where as many pictures wait as may.
    pub async fn picture(&self, id: &str, picture: Picture, profile: Option<u64>) -> Result<String, ServiceError> {
        let measurement = self.measurement(id).await?;
        let profiles_count = measurement.tally.total_count;
        if let Some(index) = profile.filter(|index| *index >= profiles_count) {
            return Err(ServiceError::ProfileUnknown { index, profiles_count });
        }
        let profile = profile.and_then(|index| usize::try_from(index).ok());
        let profiles = self.profiles(id).await?;
        let resolved = measurement.recipe.resolve(&self.defaults)?;
        let scan_id = measurement.scan_id();
        let file = self.store.open_scan(&scan_id).await?;
        let file = file.ok_or(ServiceError::ScanFileMissing { id: scan_id })?;
        let limits = self.capacity.scan.clone();
        let view = View { measurement, profiles, resolved, picture, profile };
        Ok(self.drawing.run(move || view.draw(file, &limits)).await??)
    }
}

struct View {
    measurement: Measurement,
    profiles: Vec<Profile>,
    resolved: Resolved,
    picture: Picture,
    profile: Option<usize>,
}

impl View {
    fn draw(self, file: File, limits: &Limits) -> Result<String, super::MeasureError> {
        let Self { measurement, profiles, resolved, picture, profile } = self;
        let origin = Origin { parameter: Some(measurement.format), ..Origin::default() };
        let mut reader = BufReader::with_capacity(super::tee::READ_BLOCK_BYTES, file);
        let prepared = super::prepare(&mut reader, &origin.claims(), &resolved, limits)?;
        let subject = Subject { title: &measurement.id, epsilon_mm: resolved.settings.epsilon_mm, profile };
        Ok(draw(picture, &prepared.scan, &measurement.estimate(profiles), &subject))
    }
}
