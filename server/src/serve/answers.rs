//! Answers over HTTP: errors, downloads, and bytes with a tag.

use axum::Json;
use axum::body::Bytes;
use axum::extract::{FromRequestParts, Path, Query};
use axum::http::header::{CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::de::DeserializeOwned;
use serde_json::json;
use sha2::{Digest, Sha256};

use crate::protocol::fields::plain_words;

/// A status, a code for programs and words for people.
pub(crate) type HttpError = (StatusCode, &'static str, String);

/// Query parameters of a request; wrong ones are answered in JSON.
pub struct QueryOf<T>(pub T);

/// Parts of a request's path; wrong ones are answered in JSON.
pub struct PathOf<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for QueryOf<T> {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Response> {
        Query::try_from_uri(&parts.uri).map(|Query(query)| QueryOf(query)).map_err(|problem| {
            let source = std::error::Error::source(&problem).map_or_else(String::new, ToString::to_string);
            bad_request(&format!("the query after the question mark: {}", plain_words(&source)))
        })
    }
}

impl<S: Send + Sync, T: DeserializeOwned + Send> FromRequestParts<S> for PathOf<T> {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Response> {
        let path = Path::from_request_parts(parts, state).await;
        path.map(|Path(path)| PathOf(path)).map_err(|_| bad_request("the path: expected UTF-8 after every %"))
    }
}

/// The answer to a request that is wrong.
pub(crate) fn bad_request(message: &str) -> Response {
    error_response(StatusCode::BAD_REQUEST, "bad_message", message)
}

/// The answer to a method that a path does not have.
pub async fn not_allowed() -> Response {
    error_response(
        StatusCode::METHOD_NOT_ALLOWED,
        "bad_method",
        "this path is only read: expected GET or HEAD",
    )
}

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
