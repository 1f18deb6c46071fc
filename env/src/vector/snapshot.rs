//! The state of a batch: taken, given to another one, or to all environments of another one.

use super::VectorEnv;
use crate::archive::Archive;
use crate::error::{Error, Result, check_length};
use crate::lanes::LANES;
use crate::noise::scramble;

impl VectorEnv {
    /// All that the flights go on from, as bytes for [`VectorEnv::restore`]; the same for every thread count
    /// and instruction set.
    pub fn snapshot(&mut self) -> Vec<u8> {
        let mut archive = Archive::Write(self.snapshot_head(self.envs).to_vec());
        self.archive(&mut archive);
        let Archive::Write(mut bytes) = archive else { return Vec::new() };
        let sum = checksum(&bytes[SNAPSHOT_HEAD..]);
        bytes.extend_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// Goes on from where another batch of the same models and options was: to the bit as that one does.
    ///
    /// # Errors
    /// [`Error::Config`] for bytes that are none of [`VectorEnv::snapshot`], are damaged, or are of other
    /// models, options or size; nothing has changed then.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<()> {
        let body = self.check_snapshot(bytes, self.envs)?;
        self.archive(&mut Archive::Read(body));
        Ok(())
    }

    /// Returns the bytes between head and checksum.
    fn check_snapshot<'a>(&self, bytes: &'a [u8], envs: usize) -> Result<&'a [u8]> {
        let bad = |problem: &str| Err(Error::Config(format!("state: {problem}")));
        if !bytes.starts_with(SNAPSHOT_MARK) {
            return bad("these are not the bytes of a batch's state, or they are of another version");
        }
        if !bytes.starts_with(&self.snapshot_head(envs)) {
            return bad("it is of a batch of other models, options or size");
        }
        let Some((body, sum)) = bytes[SNAPSHOT_HEAD..].split_last_chunk() else {
            return bad("it is cut off");
        };
        if checksum(body).to_le_bytes() != *sum {
            return bad("it is cut off or damaged");
        }
        Ok(body)
    }

    /// Format and version, and what the batch is.
    fn snapshot_head(&self, envs: usize) -> [u8; SNAPSHOT_HEAD] {
        let mut head = [0; SNAPSHOT_HEAD];
        head[..8].copy_from_slice(SNAPSHOT_MARK);
        head[8..16].copy_from_slice(&self.fingerprint.to_le_bytes());
        head[16..].copy_from_slice(&(envs as u64).to_le_bytes());
        head
    }

    fn archive(&mut self, archive: &mut Archive<'_>) {
        let mut ready = u16::from(self.ready);
        archive.bits(&mut ready, 1);
        self.ready = ready != 0;
        for shard in &mut self.shards {
            (0..shard.tiles()).for_each(|tile| shard.archive(tile, archive));
        }
    }

    /// Every environment goes on from where the one environment of another batch was, with the same models and
    /// options: to the bit as that one does, or with `seeds`, one for each, in the noise of these.
    ///
    /// # Errors
    /// The errors of [`VectorEnv::restore`], for the bytes of a batch of one; [`Error::Shape`] for the seeds.
    pub fn restore_copies(&mut self, bytes: &[u8], seeds: Option<&[u64]>) -> Result<()> {
        check_length("seeds", self.envs, seeds.map_or(self.envs, <[u64]>::len))?;
        let body = self.check_snapshot(bytes, 1)?;
        let (ready, tile) = body.split_at(2);
        self.ready = ready[0] != 0;
        // measurements are no part of a state: a controller cannot read them before a step
        self.measured.fill(f32::NAN);
        let mut first = 0;
        for shard in &mut self.shards {
            for i in 0..shard.tiles() {
                let seeds =
                    seeds.map(|seeds| std::array::from_fn(|lane| *seeds.get(first + lane).unwrap_or(&0)));
                shard.archive(i, &mut Archive::Spread(tile, seeds));
                first += LANES;
            }
        }
        Ok(())
    }
}

/// First bytes of a snapshot: format and version.
const SNAPSHOT_MARK: &[u8; 8] = b"cfstate2";
/// With the fingerprint and the number of environments.
const SNAPSHOT_HEAD: usize = 24;

pub(super) fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(bytes.len() as u64, |sum, byte| scramble(sum ^ u64::from(*byte)))
}
