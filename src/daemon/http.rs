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
use std::sync::{Arc, Mutex, PoisonError};

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::HOST;
use hyper::http::uri::Authority;
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;

use super::counter_table::COUNTERS;
use super::health::View;
use super::metrics;
use crate::http::{self, PATIENCE, ip_of, is_localhost, response, text};

/// Most connections at a time.
const CONNECTIONS: usize = 16;

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
    let converse = |stream, place| {
        let view = Arc::clone(&view);
        async move {
            let _ = timeout(PATIENCE, converse(stream, view, is_public)).await;
            drop(place);
        }
    };
    http::accept(listener, CONNECTIONS, converse).await
}

async fn converse(stream: TcpStream, view: Arc<Mutex<View>>, is_public: bool) {
    let service = service_fn(|request| {
        let response = answer(&request, &view, is_public);
        async move { Ok::<_, Infallible>(response) }
    });
    let mut http = http::connection();
    http.keep_alive(false);
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
    if let Some(refused) = http::refused_method(request) {
        return refused;
    }
    let view = view.lock().unwrap_or_else(PoisonError::into_inner);
    match request.uri().path() {
        "/health" => {
            let (is_well, report) = view.report(COUNTERS);
            let status = if is_well {
                StatusCode::OK
            } else {
                StatusCode::SERVICE_UNAVAILABLE
            };
            response(status, "application/json", format!("{report:#}\n"))
        }
        "/metrics" => match metrics::encode(&view, COUNTERS) {
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
    is_localhost(authority) || ip_of(authority).is_some()
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
