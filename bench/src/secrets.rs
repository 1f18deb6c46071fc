//! The signing key, the secret that seeds are derived from, and what is made of them. Nothing here can be
//! printed.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use hmac::{Hmac, KeyInit, Mac};
use sha2::{Digest, Sha256};

use super::error::{Error, Result};

/// Secret numbers, 32 bytes each.
pub(super) type Bytes = [u8; 32];

/// The keys of whoever signs, or of whoever verifies with a secret that was published.
#[derive(Clone)]
pub(super) struct Secrets {
    /// None for who only verifies.
    signing: Option<SigningKey>,
    key: VerifyingKey,
    secret: Bytes,
    /// Hashes of what was signed, with its signature, that were found right.
    verified: Arc<Mutex<HashSet<Bytes>>>,
}

/// Signatures that are remembered, some 5 MB.
const MOST_VERIFIED: usize = 1 << 17;

impl Secrets {
    pub(super) fn new(signing: &Bytes, secret: Bytes) -> Self {
        let signing = SigningKey::from_bytes(signing);
        Secrets { key: signing.verifying_key(), signing: Some(signing), secret, verified: Arc::default() }
    }

    /// Without the key that signs.
    pub(super) fn verifier(key: VerifyingKey, secret: Bytes) -> Self {
        Secrets { signing: None, key, secret, verified: Arc::default() }
    }

    /// The same keys with another secret.
    pub(super) fn with_secret(&self, secret: Bytes) -> Self {
        Secrets { secret, ..self.clone() }
    }

    /// The secret, to be published.
    pub(super) fn secret_hex(&self) -> String {
        hex::encode(self.secret)
    }

    pub(super) fn public_key(&self) -> VerifyingKey {
        self.key
    }

    /// # Errors
    /// [`Error::Archive`] without the key that signs.
    pub(super) fn sign(&self, bytes: &[u8]) -> Result<[u8; 64]> {
        Ok(self.signing.as_ref().ok_or(Error::Archive)?.sign(bytes).to_bytes())
    }

    pub(super) fn is_signature_valid(&self, bytes: &[u8], signature: &[u8]) -> bool {
        let Ok(signature) = Signature::from_slice(signature) else { return false };
        let hash = Sha256::new().chain_update(signature.to_bytes()).chain_update(bytes).finalize().into();
        let verified = || self.verified.lock().unwrap_or_else(PoisonError::into_inner);
        if verified().contains(&hash) {
            return true;
        }
        let valid = self.key.verify_strict(bytes, &signature).is_ok();
        if valid {
            let mut verified = verified();
            if verified.len() >= MOST_VERIFIED {
                verified.clear();
            }
            verified.insert(hash);
        }
        valid
    }

    /// HMAC-SHA256 under the secret. The parts are separated by their lengths.
    pub(super) fn derive(&self, parts: &[&[u8]]) -> Result<Bytes> {
        let mut mac =
            Hmac::<Sha256>::new_from_slice(&self.secret).map_err(|e| Error::Internal(e.to_string()))?;
        for part in parts {
            mac.update(&(part.len() as u64).to_le_bytes());
            mac.update(part);
        }
        Ok(mac.finalize().into_bytes().into())
    }

    /// The seeds of an attempt's episodes.
    pub(super) fn seeds(&self, attempt: &str, scenario_hash: &str, episodes: usize) -> Result<Vec<u64>> {
        let seed = |episode: usize| {
            let bytes = self.derive(&[
                b"seed",
                attempt.as_bytes(),
                scenario_hash.as_bytes(),
                &(episode as u64).to_le_bytes(),
            ])?;
            Ok(u64::from_le_bytes(std::array::from_fn(|i| bytes[i])))
        };
        (0..episodes).map(seed).collect()
    }
}

/// Random bytes of the operating system.
pub(super) fn random<const N: usize>() -> Result<[u8; N]> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes)
        .map_err(|e| Error::Internal(format!("the operating system gives no random numbers: {e}")))?;
    Ok(bytes)
}

/// SHA-256 in hex.
pub(super) fn sha256_hex(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// RFC 8785: the one way to write a JSON value down, in any language.
pub(super) fn canonical(value: &impl serde::Serialize) -> Result<Vec<u8>> {
    serde_json_canonicalizer::to_vec(value).map_err(|e| Error::Internal(format!("canonical JSON: {e}")))
}
