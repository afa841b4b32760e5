//! One call to a device: until it answers, its deadline passes, or a halt that is due has waited long enough for it.

use super::Gone;
use super::halts::Halts;
use crate::device::{DeviceError, Pending};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::sleep;

/// How long a call may take.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    /// At most.
    pub(super) deadline: Duration,
    /// Once a halt is due.
    pub(super) grace: Duration,
    /// The newest halt that is no reason to hurry.
    pub(super) handled: u64,
}

/// What came of a call that was answered.
pub(in crate::cell) type Answer<T> = Result<T, DeviceError>;

/// Waits for the answer. The outer error says that the call was dropped, which costs the connection.
pub(super) async fn call<T>(
    device: &str,
    pending: Pending<'_, Answer<T>>,
    halts: &watch::Receiver<Halts>,
    patience: Patience,
) -> Result<Answer<T>, Gone> {
    tokio::select! {
        biased;
        answer = pending => Ok(answer),
        () = hurry(halts.clone(), patience) => Err(Gone::Cut),
        () = sleep(patience.deadline) => {
            Err(Gone::Lost(DeviceError::Silent { device: device.to_owned(), within: patience.deadline }))
        }
    }
}

/// Ends when a halt has waited long enough.
async fn hurry(mut halts: watch::Receiver<Halts>, patience: Patience) {
    if !raised(&mut halts, patience.handled).await {
        // Nobody can raise a halt any more.
        std::future::pending::<()>().await;
    }
    sleep(patience.grace).await;
}

/// Waits for a halt that is newer than `handled`. False where nobody can raise one any more.
pub(super) async fn raised(halts: &mut watch::Receiver<Halts>, handled: u64) -> bool {
    halts.wait_for(|halts| halts.number > handled).await.is_ok()
}
