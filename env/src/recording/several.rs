//! Recording an environment of several drones.

use super::{Recorder, Recording};
use crate::error::{Error, Result};
use crate::task::Task;

impl Recorder<'_> {
    pub(super) fn record_several<T: Task>(self, _task: &T, drones: usize) -> Result<Recording> {
        Err(Error::Config(format!("{drones} drones")))
    }
}
