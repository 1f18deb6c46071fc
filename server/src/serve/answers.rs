//! Answers over HTTP: errors, downloads, and bytes with a tag.

use axum::Json;
use axum::body::Bytes;
use axum::http::header::{CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde_json::json;
use sha2::{Digest, Sha256};

/// A status and words for people.
pub(crate) type HttpError = (StatusCode, String);

/// An error in JSON, with a code for programs and words for people.
pub fn error_response(status: StatusCode, code: &str, message: &str) -> Response {
    (status, Json(json!({"type": "error", "code": code, "message": message}))).into_response()
}

/// A download. Its file name keeps letters, digits and `-._`.
pub fn as_attachment(name: &str, mut response: Response) -> Response {
    let plain: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() || "-._".contains(c) { c } else { '_' }).collect();
    if response.status().is_success()
        && let Ok(value) = format!("attachment; filename=\"{plain}\"").parse()
    {
        response.headers_mut().insert(CONTENT_DISPOSITION, value);
    }
    response
}

/// Bytes that seldom change, and a tag by which a browser checks whether they are still the same.
#[derive(Clone)]
pub struct TaggedBody {
    content_type: &'static str,
    bytes: Bytes,
    tag: String,
}

impl TaggedBody {
    /// Tagged by its hash.
    pub fn new(content_type: &'static str, bytes: Bytes) -> TaggedBody {
        let hash = Sha256::digest(&bytes);
        TaggedBody::with_hash(content_type, bytes, &hash)
    }

    pub(super) fn with_hash(content_type: &'static str, bytes: Bytes, hash: &[u8]) -> TaggedBody {
        TaggedBody { content_type, bytes, tag: format!("\"{}\"", hex::encode(&hash[..16])) }
    }

    /// The bytes, or that they are what the browser has.
    pub fn response(&self, request_headers: &HeaderMap) -> Response {
        let known = request_headers.get(IF_NONE_MATCH).and_then(|known| known.to_str().ok());
        let same = known.is_some_and(|known| known.contains(&self.tag));
        let headers =
            [(CONTENT_TYPE, self.content_type), (CACHE_CONTROL, "no-cache"), (ETAG, self.tag.as_str())];
        if same {
            (StatusCode::NOT_MODIFIED, headers).into_response()
        } else {
            (headers, self.bytes.clone()).into_response()
        }
    }
}
