//! The health channel: what the sensor says about itself, unasked, about every second.

use super::channel::{Channel, Peer};
use super::codec::{Message, decode};
use super::drops::Wellness;
use super::settings::{Settings, duration};
use crate::device::error::DeviceError;
use std::time::Duration;
use tokio::time::timeout;

const FRAME_BYTES_MAX: usize = 1024 * 1024;

/// The health channel and what was heard on it.
#[derive(Debug)]
pub(super) struct HealthLink {
    channel: Channel,
    pub(super) wellness: Wellness,
    pub(super) within: Duration,
    heard: bool,
}

impl HealthLink {
    /// Connects. `hears` says whether to wait for the first message, too.
    pub(super) async fn open(peer: &Peer, settings: &Settings, hears: bool) -> Result<Self, DeviceError> {
        let connect_within = duration(settings.deadlines.connect_ms);
        let mut link = Self {
            channel: Channel::open(peer, settings.health_port, connect_within, FRAME_BYTES_MAX).await?,
            wellness: Wellness::default(),
            within: duration(settings.deadlines.health_ms),
            heard: false,
        };
        if hears {
            link.hear_first().await?;
        }
        Ok(link)
    }

    /// Waits for the first message, unless it has come already.
    pub(super) async fn hear_first(&mut self) -> Result<(), DeviceError> {
        if self.heard { Ok(()) } else { self.hear_until(|_| true).await }
    }

    /// Waits for more, and takes it: how many messages. Nothing is lost where it is dropped on the way.
    pub(super) async fn hear(&mut self) -> Result<u32, DeviceError> {
        self.channel.fill().await?;
        self.take_all()
    }

    /// Waits for a message after which this is so, for as long as one may take.
    pub(super) async fn hear_until(&mut self, is_so: impl Fn(&Wellness) -> bool) -> Result<(), DeviceError> {
        let within = self.within;
        let hearing = async {
            while self.hear().await? == 0 || !is_so(&self.wellness) {}
            Ok(())
        };
        let heard = timeout(within, hearing).await;
        heard.unwrap_or_else(|_| Err(self.channel.peer.silent(within)))
    }

    /// Takes what has come already.
    pub(super) fn catch_up(&mut self) -> Result<(), DeviceError> {
        while self.channel.fill_at_once()? {
            self.take_all()?;
        }
        Ok(())
    }

    fn take_all(&mut self) -> Result<u32, DeviceError> {
        let Self { channel, wellness, heard, .. } = self;
        let peer = channel.peer.clone();
        let mut heard_count = 0;
        while let Some(frame) = channel.frame().map_err(|error| peer.senseless(&error))? {
            if let Message::Health(health) = decode(frame).map_err(|error| peer.senseless(&error))?.message {
                wellness.take(&health);
                (*heard, heard_count) = (true, heard_count + 1);
            }
        }
        Ok(heard_count)
    }
}
