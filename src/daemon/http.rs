//! Health and metrics over HTTP, for people and for monitoring.
//!
//! ```text
//! GET /health    200 or 503 and JSON: how every sensor is, with the reasons; what came through every port
//! GET /metrics   Prometheus (OpenMetrics text)
//! ```
//!
//! The number of connections is limited, each is for one request and has a time limit, so that no
//! client can delay the daemon. Unless `http_public` is set, requests to a host name other than
//! `localhost` are refused: otherwise a web page whose name resolves to this host (DNS rebinding)
//! could read the answers in a browser here.

use std::convert::Infallible;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{ALLOW, CACHE_CONTROL, CONTENT_TYPE, HOST, HeaderValue};
use hyper::http::uri::Authority;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;

use super::health::View;
use super::metrics;

/// Most simultaneous connections; more are closed at once.
const CONNECTIONS: usize = 16;
/// Time limit of a connection.
const PATIENCE: Duration = Duration::from_secs(5);
/// Most bytes of a request; the least limit that hyper accepts.
const REQUEST_BYTES: usize = 8192;

/// Where health and metrics are served.
pub struct Http {
    /// The socket.
    pub listener: TcpListener,
    /// Whether requests to any host name are answered, not only to IP addresses and `localhost`.
    pub is_public: bool,
}

/// Answers until the daemon ends.
pub async fn serve(http: &Http, view: Arc<Mutex<View>>) -> Infallible {
    let &Http {
        ref listener,
        is_public,
    } = http;
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Most likely there are no free file descriptors: retry later.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            continue;
        };
        let view = Arc::clone(&view);
        tokio::spawn(async move {
            let _ = timeout(PATIENCE, converse(stream, view, is_public)).await;
            drop(place);
        });
    }
}

async fn converse(stream: TcpStream, view: Arc<Mutex<View>>, is_public: bool) {
    let service = service_fn(|request| {
        let response = answer(&request, &view, is_public);
        async move { Ok::<_, Infallible>(response) }
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new())
        .header_read_timeout(PATIENCE)
        .max_buf_size(REQUEST_BYTES)
        .keep_alive(false);
    // An error means that the client closed the connection.
    let _ = http.serve_connection(TokioIo::new(stream), service).await;
}

fn answer(
    request: &Request<Incoming>,
    view: &Mutex<View>,
    is_public: bool,
) -> Response<Full<Bytes>> {
    if !is_public && !is_for_this_host(request) {
        return text(
            StatusCode::FORBIDDEN,
            "only requests to an IP address or to localhost are answered; `http_public = true` allows other names",
        );
    }
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        let mut refused = text(StatusCode::METHOD_NOT_ALLOWED, "only GET and HEAD");
        refused
            .headers_mut()
            .insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
        return refused;
    }
    let view = view.lock().unwrap_or_else(PoisonError::into_inner);
    match request.uri().path() {
        "/health" => {
            let (is_well, report) = view.report();
            let status = if is_well {
                StatusCode::OK
            } else {
                StatusCode::SERVICE_UNAVAILABLE
            };
            response(status, "application/json", format!("{report:#}\n"))
        }
        "/metrics" => match metrics::encode(&view) {
            Ok(text) => response(StatusCode::OK, metrics::CONTENT_TYPE, text),
            Err(_) => text(
                StatusCode::INTERNAL_SERVER_ERROR,
                "the metrics cannot be written",
            ),
        },
        _ => text(StatusCode::NOT_FOUND, "there are /health and /metrics"),
    }
}

/// Whether each host name in a request is `localhost` or an IP address, which DNS cannot redirect.
/// Browsers always send one; very old programs may not.
fn is_for_this_host<B>(request: &Request<B>) -> bool {
    let mut hosts = request.headers().get_all(HOST).iter();
    request.uri().authority().is_none_or(is_own)
        && hosts.all(|value| Authority::try_from(value.as_bytes()).is_ok_and(|host| is_own(&host)))
}

/// Whether it is an IP address or `localhost`.
fn is_own(authority: &Authority) -> bool {
    let host = authority.host();
    let ip = host
        .strip_prefix('[')
        .and_then(|host| host.strip_suffix(']'))
        .unwrap_or(host);
    host.eq_ignore_ascii_case("localhost") || ip.parse::<IpAddr>().is_ok()
}

fn text(status: StatusCode, text: &str) -> Response<Full<Bytes>> {
    response(status, "text/plain; charset=utf-8", format!("{text}\n"))
}

fn response(status: StatusCode, kind: &'static str, body: String) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(Bytes::from(body)));
    *response.status_mut() = status;
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_may_lead_anywhere_are_not_of_this_host() {
        let is_for_this_host = |uri: &str, hosts: &[&str]| {
            let request = hosts.iter().fold(Request::get(uri), |request, &host| {
                request.header(HOST, host)
            });
            is_for_this_host(&request.body(()).unwrap())
        };
        for host in [
            "localhost",
            "LocalHost:9177",
            "127.0.0.1",
            "127.0.0.1:9177",
            "10.0.0.7:80",
            "[::1]",
            "[::1]:9177",
        ] {
            assert!(is_for_this_host("/health", &[host]), "{host}");
            assert!(
                is_for_this_host(&format!("http://{host}/health"), &["localhost"]),
                "{host}"
            );
        }
        assert!(is_for_this_host("/health", &[]));
        for host in [
            "evil.example",
            "evil.example:9177",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "",
            "a b",
        ] {
            assert!(!is_for_this_host("/health", &[host]), "{host}");
            assert!(!is_for_this_host("/health", &["localhost", host]), "{host}");
        }
        assert!(!is_for_this_host(
            "http://evil.example/health",
            &["localhost"]
        ));
    }
}
