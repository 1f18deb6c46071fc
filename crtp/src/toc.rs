//! Tables of contents: a client's queries for the parameters and log variables that exist.

use crate::packet::Fields;

/// A line of a table as clients see it.
pub(crate) struct TocLine {
    /// Kind and access.
    pub code: u8,
    /// Group and name with a point between.
    pub name: &'static str,
}

impl TocLine {
    /// Kind, group, name; both end with a zero.
    fn bytes(&self) -> Vec<u8> {
        let (group, name) = self.name.split_once('.').unwrap_or(("", self.name));
        [&[self.code], group.as_bytes(), &[0], name.as_bytes(), &[0]].concat()
    }
}

/// A table with the checksum by which clients keep it.
pub(crate) struct Toc {
    lines: Vec<TocLine>,
    crc: u32,
    /// Sent after the checksum: what else a client may want to know of the service.
    extra: &'static [u8],
}

const ITEM: u8 = 2;
const INFO: u8 = 3;

impl Toc {
    pub(crate) fn new(lines: Vec<TocLine>, extra: &'static [u8]) -> Toc {
        let bytes: Vec<u8> = lines.iter().flat_map(TocLine::bytes).collect();
        Toc { lines, crc: crc32fast::hash(&bytes), extra }
    }

    /// The answer to a request on the channel of the table; nothing for requests that there are not.
    pub(crate) fn answer(&self, request: &[u8]) -> Option<Vec<u8>> {
        let mut fields = Fields(request);
        match fields.u8()? {
            INFO => {
                let count = (self.lines.len() as u16).to_le_bytes();
                Some([&[INFO][..], &count, &self.crc.to_le_bytes(), self.extra].concat())
            }
            ITEM => {
                let id = fields.u16()?;
                // the firmware answers an id beyond the table with the command alone
                let line = self
                    .lines
                    .get(usize::from(id))
                    .map_or(Vec::new(), |line| [&id.to_le_bytes()[..], &line.bytes()].concat());
                Some([&[ITEM][..], &line].concat())
            }
            _ => None,
        }
    }
}
