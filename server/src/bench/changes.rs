//! Whether the database has changed, asked without reading what is in it.

use std::path::Path;

use rusqlite::{Connection, OpenFlags};

use super::error::Result;

/// A connection of its own: SQLite tells it of the commits of all others, those of other processes too.
pub(crate) struct StoreChanges {
    db: Connection,
    seen: Option<i64>,
}

impl StoreChanges {
    /// Of a database that is there.
    pub(crate) fn open(path: &Path) -> Result<StoreChanges> {
        // nothing is written, but whoever closes a database last must be able to tidy up its log
        let db = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE)?;
        Ok(StoreChanges { db, seen: None })
    }

    /// Whether anything was committed since the last call; true the first time.
    pub(crate) fn happened(&mut self) -> Result<bool> {
        let now = self.db.pragma_query_value(None, "data_version", |row| row.get(0))?;
        Ok(self.seen.replace(now) != Some(now))
    }

    /// Has the next call say yes.
    pub(crate) fn forget(&mut self) {
        self.seen = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::baselines::submit;
    use crate::bench::{Bench, TeamLimits};
    use crazyflie_control::ControllerSpec;

    #[test]
    fn a_stored_attempt_is_noticed_and_nothing_else() {
        let folder = std::env::current_exe().unwrap().with_file_name("bench-tests").join("changes");
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("bench.sqlite");
        let bench = Bench::open(&path, TeamLimits::default()).unwrap();
        let mut changes = StoreChanges::open(&path).unwrap();
        assert!(changes.happened().unwrap() && !changes.happened().unwrap());
        bench.attempts(None).unwrap();
        assert!(!changes.happened().unwrap(), "reading is no change");
        submit(&bench, "takeoff", &ControllerSpec::named("thesis-pid").unwrap().into()).unwrap();
        assert!(changes.happened().unwrap() && !changes.happened().unwrap());
        // the database is one file again, whoever closes it last
        drop(bench);
        drop(changes);
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
    }
}
