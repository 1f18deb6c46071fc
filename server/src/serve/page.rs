//! The page: files of `server/page/`, built into the program.

use axum::body::Bytes;
use axum::http::header::{ALLOW, CONTENT_SECURITY_POLICY, REFERRER_POLICY};
use axum::http::{HeaderMap, Method, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use rust_embed::RustEmbed;

use super::answers::{TaggedBody, error_response, not_allowed};

#[derive(RustEmbed)]
#[folder = "page/"]
struct Files;

/// Nothing but the page's own files: no inline script, no eval, no other host, nobody's frame.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

/// Content types by file name ending. Files with other endings are not served.
const TYPES: [(&str, &str); 5] = [
    ("html", "text/html; charset=utf-8"),
    ("css", "text/css; charset=utf-8"),
    ("js", "text/javascript; charset=utf-8"),
    ("svg", "image/svg+xml"),
    ("LICENSE", "text/plain; charset=utf-8"),
];

fn content_type(path: &str) -> Option<&'static str> {
    let ending = path.rsplit(['.', '/']).next()?;
    TYPES.iter().find(|(known, _)| *known == ending).map(|(_, content_type)| *content_type)
}

/// Answers whatever no other route does. The page is new after every update of the program: browsers check each time
/// by the file's hash whether it has changed.
pub(crate) async fn page(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    if method != Method::GET && method != Method::HEAD {
        return ([(ALLOW, "GET, HEAD")], not_allowed().await).into_response();
    }
    let path = match uri.path().trim_start_matches('/') {
        "" => "index.html",
        path => path,
    };
    let (Some(file), Some(content_type)) = (Files::get(path), content_type(path)) else {
        return error_response(StatusCode::NOT_FOUND, "not_found", "there is nothing here");
    };
    let hash = file.metadata.sha256_hash();
    let body = TaggedBody::with_hash(content_type, Bytes::from_owner(file.data), &hash);
    let policies = [(CONTENT_SECURITY_POLICY, POLICY), (REFERRER_POLICY, "no-referrer")];
    (policies, body.response(&headers)).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_but_the_notes_has_a_type() {
        let unknown: Vec<_> = Files::iter().filter(|path| content_type(path).is_none()).collect();
        assert_eq!(unknown, ["vendor/README.md"]);
    }

    #[test]
    fn nothing_is_inline_and_nothing_comes_from_elsewhere() {
        let own = Files::iter().filter(|path| !path.starts_with("vendor/"));
        let texts: Vec<_> = own
            .map(|path| {
                (path.to_string(), String::from_utf8(Files::get(&path).unwrap().data.into_owned()).unwrap())
            })
            .collect();
        assert!(texts.len() > 20, "{} files of our own", texts.len());
        for (path, text) in texts {
            // the name of a format, not a place
            let text = text.replace("http://www.w3.org/2000/svg", "");
            for banned in ["http://", "https://", " style=\"", "onclick=\"", "innerHTML", "eval("] {
                assert!(!text.contains(banned), "{path} says {banned}");
            }
        }
        let index = String::from_utf8(Files::get("index.html").unwrap().data.into_owned()).unwrap();
        assert!(
            index.matches("<script").count() == 1
                && index.contains("<script type=\"module\" src=\"js/main.js\">")
        );
    }
}
