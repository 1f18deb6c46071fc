//! Looking for secrets in bytes, however they may be written down.

use aho_corasick::AhoCorasick;
use base64::Engine;
use base64::engine::general_purpose::{STANDARD_NO_PAD, URL_SAFE_NO_PAD};

/// Names of secrets, and all spellings that give them away.
pub struct Needles {
    pub all: Vec<(String, Vec<u8>)>,
    searcher: AhoCorasick,
}

impl Needles {
    pub fn new(secrets: &[(String, Vec<u8>)]) -> Needles {
        let spelled = |(name, bytes): &(String, Vec<u8>)| {
            spellings(bytes).into_iter().map(|spelling| (name.clone(), spelling)).collect::<Vec<_>>()
        };
        let all: Vec<_> = secrets.iter().flat_map(spelled).collect();
        let searcher = AhoCorasick::new(all.iter().map(|(_, spelling)| spelling)).unwrap();
        Needles { all, searcher }
    }

    /// The secret that is in these bytes, if one is.
    pub fn find(&self, bytes: &[u8]) -> Option<&str> {
        self.searcher.find(bytes).map(|hit| &self.all[hit.pattern().as_usize()].0[..])
    }
}

/// Returns the spellings of bytes: as bytes, from either end; in hex; in base64 at any place of a longer text; as
/// numbers if they are eight.
fn spellings(bytes: &[u8]) -> Vec<Vec<u8>> {
    let reversed: Vec<u8> = bytes.iter().rev().copied().collect();
    let mut all = Vec::new();
    for bytes in [bytes, &reversed] {
        all.push(bytes.to_vec());
        all.push(hex::encode(bytes).into_bytes());
        all.push(hex::encode_upper(bytes).into_bytes());
        for before in 0..3 {
            let padded = [&[0; 2][..before], bytes].concat();
            for text in [STANDARD_NO_PAD.encode(&padded), URL_SAFE_NO_PAD.encode(&padded)] {
                // without the letters that are partly of what stands before or after
                all.push(text.as_bytes()[(8 * before).div_ceil(6)..8 * padded.len() / 6].to_vec());
            }
        }
        if let Ok(eight) = <[u8; 8]>::try_from(bytes) {
            all.push(u64::from_le_bytes(eight).to_string().into_bytes());
            all.push(i64::from_le_bytes(eight).to_string().into_bytes());
        }
    }
    all
}
