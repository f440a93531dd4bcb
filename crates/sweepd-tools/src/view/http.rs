//! The server of the page: its embedded files, and the socket.
//!
//! ```text
//! GET /             the page
//! GET /page/NAME    its other files
//! GET /socket       a WebSocket: sweeps to the page, commands from it
//! GET /             as a WebSocket: messages to Foxglove and its like
//! ```
//!
//! Any web page that a browser on this host shows can send requests here. So a request must name the
//! address that is listened on, which a name that was redirected (DNS rebinding) is not; the page's
//! socket must be asked for by the page itself, and that of a viewer by a program that is no browser,
//! or by a page that may read. Connections, their time and their bytes are limited.

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    CONNECTION, CONTENT_SECURITY_POLICY, HOST, HeaderMap, HeaderName, HeaderValue, ORIGIN,
    REFERRER_POLICY, SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_PROTOCOL,
    SEC_WEBSOCKET_VERSION, UPGRADE, X_CONTENT_TYPE_OPTIONS,
};
use hyper::http::uri::Authority;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;

use super::channels::Channels;
use super::{foxglove, page, socket};
use sweepd::cli::complain;
use sweepd::http::{self, PATIENCE, ip_of, is_localhost, response, text};

/// Most connections at a time.
const CONNECTIONS: usize = 64;
/// Most pages and viewers that are open at a time.
const PAGES: usize = 8;
/// Origins that are told to be refused: any web page can ask, again and again.
const TOLD: usize = 8;
/// Origins of viewers: apps on the desktop, whose page is a file, Foxglove and Lichtblick on the web.
/// In a browser a file is of no origin (`null`; tried with Chromium 156), as a hostile page can make one
/// of its frames.
const VIEWERS: [&str; 3] = [
    "file://",
    "https://app.foxglove.dev",
    "https://lichtblick-suite.github.io",
];

/// A server.
pub(super) struct Server {
    listener: TcpListener,
    address: SocketAddr,
    channels: Channels,
    /// Other origins of viewers.
    origins: Vec<String>,
    told: Mutex<BTreeSet<String>>,
    pages: Arc<Semaphore>,
}

impl Server {
    pub(super) fn new(
        listener: TcpListener,
        address: SocketAddr,
        channels: Channels,
        origins: Vec<String>,
    ) -> Arc<Self> {
        Arc::new(Self {
            listener,
            address,
            channels,
            origins,
            told: Mutex::default(),
            pages: Arc::new(Semaphore::new(PAGES)),
        })
    }

    /// Answers for ever.
    pub(super) async fn serve(self: Arc<Self>) -> Infallible {
        let converse = |stream, place| Arc::clone(&self).converse(stream, place);
        http::accept(&self.listener, CONNECTIONS, converse).await
    }

    async fn converse(self: Arc<Self>, stream: TcpStream, place: OwnedSemaphorePermit) {
        // Small messages are not to wait for more.
        let _ = stream.set_nodelay(true);
        let place = Arc::new(place);
        let service = service_fn(|request| {
            let response = self.answer(request, &place);
            async move { Ok::<_, Infallible>(response) }
        });
        let conversation = http::connection()
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades();
        // An error means that the client closed the connection. A socket goes on in its own task.
        let _ = timeout(PATIENCE, conversation).await;
    }

    fn answer(
        &self,
        request: Request<Incoming>,
        place: &Arc<OwnedSemaphorePermit>,
    ) -> Response<Full<Bytes>> {
        let Some(host) = self.host(&request) else {
            let refused = match self.address.ip().is_unspecified() {
                true => "only requests to an IP address of this host or to localhost are answered"
                    .to_owned(),
                false => format!(
                    "only requests to the address that is listened on are answered: open http://{}/",
                    self.address
                ),
            };
            let mut refused = text(StatusCode::FORBIDDEN, &refused);
            secure(refused.headers_mut(), "127.0.0.1");
            return refused;
        };
        let mut response = self.answer_to(request, &host, place);
        secure(response.headers_mut(), &host);
        response
    }

    fn answer_to(
        &self,
        request: Request<Incoming>,
        host: &str,
        place: &Arc<OwnedSemaphorePermit>,
    ) -> Response<Full<Bytes>> {
        if let Some(refused) = http::refused_method(&request) {
            return refused;
        }
        let headers = request.headers();
        match request.uri().path() {
            "/socket" if is_origin(headers, host) => return self.socket(request, None, place),
            "/socket" => {
                let refused = "only the page itself may open the socket";
                return text(StatusCode::FORBIDDEN, refused);
            }
            "/" if has_word(headers, &UPGRADE, "websocket") => {
                return self.viewer(request, host, place);
            }
            _ => {}
        }
        let Some(file) = page::find(request.uri().path()) else {
            return text(
                StatusCode::NOT_FOUND,
                "there is nothing here; the page is at /",
            );
        };
        response(StatusCode::OK, file.kind, file.bytes())
    }

    /// The host that a request names, if it is this server.
    fn host<B>(&self, request: &Request<B>) -> Option<String> {
        let mut named = request.headers().get_all(HOST).iter();
        let (Some(host), None) = (named.next(), named.next()) else {
            return None;
        };
        let host = host.to_str().ok()?;
        let uri = request.uri().authority();
        (is_own(host, self.address) && uri.is_none_or(|uri| is_own(uri.as_str(), self.address)))
            .then(|| host.to_owned())
    }

    /// Answers a viewer that wants a socket.
    fn viewer(
        &self,
        request: Request<Incoming>,
        host: &str,
        place: &Arc<OwnedSemaphorePermit>,
    ) -> Response<Full<Bytes>> {
        let headers = request.headers();
        if let Err(origin) = may_read(headers, host, &self.origins) {
            let refused = format!(
                "a web page of {origin} may not read what the sensor sees: --allow-origin {origin} allows it"
            );
            // A browser does not show the answer.
            let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
            if told.len() < TOLD && origin.len() <= 100 && told.insert(origin.to_owned()) {
                complain("warning", &refused);
            }
            return text(StatusCode::FORBIDDEN, &refused);
        }
        let is_asked = |name: &&str| has_word(headers, &SEC_WEBSOCKET_PROTOCOL, name);
        match foxglove::PROTOCOLS.into_iter().find(is_asked) {
            Some(protocol) => self.socket(request, Some(protocol), place),
            None => text(
                StatusCode::BAD_REQUEST,
                "expected the sub-protocol foxglove.websocket.v1 or foxglove.sdk.v1",
            ),
        }
    }

    /// Answers a page, or a viewer that is to speak this sub-protocol, with a socket.
    fn socket(
        &self,
        mut request: Request<Incoming>,
        protocol: Option<&'static str>,
        place: &Arc<OwnedSemaphorePermit>,
    ) -> Response<Full<Bytes>> {
        let headers = request.headers();
        let key = headers.get(SEC_WEBSOCKET_KEY).filter(|key| key.len() == 24);
        let is_handshake = request.method() == Method::GET
            && has_word(headers, &UPGRADE, "websocket")
            && has_word(headers, &CONNECTION, "upgrade")
            && has_word(headers, &SEC_WEBSOCKET_VERSION, "13");
        let Some(key) = key.filter(|_| is_handshake) else {
            return text(
                StatusCode::BAD_REQUEST,
                "expected a WebSocket (RFC 6455, version 13)",
            );
        };
        let accept = HeaderValue::try_from(derive_accept_key(key.as_bytes()));
        let (Ok(page), Ok(accept)) = (Arc::clone(&self.pages).try_acquire_owned(), accept) else {
            let full = format!("{PAGES} pages and viewers are open, and no more may be: close one");
            return text(StatusCode::SERVICE_UNAVAILABLE, &full);
        };
        let channels = self.channels.clone();
        let upgrade = hyper::upgrade::on(&mut request);
        let place = Arc::clone(place);
        tokio::spawn(async move {
            if let Ok(Ok(upgraded)) = timeout(PATIENCE, upgrade).await {
                let stream = TokioIo::new(upgraded);
                match protocol {
                    None => socket::converse(stream, channels).await,
                    Some(_) => foxglove::converse(stream, channels).await,
                }
            }
            drop((page, place));
        });
        let mut response = Response::new(Full::default());
        *response.status_mut() = StatusCode::SWITCHING_PROTOCOLS;
        let headers = response.headers_mut();
        headers.insert(UPGRADE, HeaderValue::from_static("websocket"));
        headers.insert(CONNECTION, HeaderValue::from_static("Upgrade"));
        headers.insert(SEC_WEBSOCKET_ACCEPT, accept);
        if let Some(protocol) = protocol {
            let protocol = HeaderValue::from_static(protocol);
            headers.insert(SEC_WEBSOCKET_PROTOCOL, protocol);
        }
        response
    }
}

/// Whether a host is the address that is listened on, or `localhost`; where any address of this host
/// is listened on, any IP address: only names can be redirected. The port is that of a tunnel, where
/// there is one.
fn is_own(host: &str, address: SocketAddr) -> bool {
    let Ok(authority) = Authority::try_from(host) else {
        return false;
    };
    if host.contains('@') {
        return false;
    }
    match ip_of(&authority) {
        Some(ip) => ip == address.ip() || address.ip().is_unspecified(),
        None => is_localhost(&authority),
    }
}

/// Whether the one origin of a request is the page of this host.
fn is_origin(headers: &HeaderMap, host: &str) -> bool {
    let mut origins = headers.get_all(ORIGIN).iter();
    let (Some(origin), None) = (origins.next(), origins.next()) else {
        return false;
    };
    let host_of = |origin: &HeaderValue| {
        origin
            .to_str()
            .ok()?
            .strip_prefix("http://")
            .map(str::to_owned)
    };
    host_of(origin).is_some_and(|origin| origin.eq_ignore_ascii_case(host))
}

/// Whether the origin of a request for a viewer's socket may read; else that origin. It may be none: then it
/// is no browser. It may be a page of this host (`host`, or `localhost`), of [`VIEWERS`], or of `others`.
fn may_read(headers: &HeaderMap, host: &str, others: &[String]) -> Result<(), String> {
    let mut origins = headers.get_all(ORIGIN).iter();
    let origin = match (origins.next(), origins.next()) {
        (None, _) => return Ok(()),
        (Some(origin), None) => origin.to_str().unwrap_or("another character set"),
        _ => return Err("several origins".to_owned()),
    };
    if VIEWERS.contains(&origin) || others.iter().any(|other| other == origin) {
        return Ok(());
    }
    let authority = |text: &str| Authority::try_from(text).ok();
    let named = origin
        .split_once("://")
        .and_then(|(_, named)| authority(named));
    let is_here = named.is_some_and(|named| {
        is_localhost(&named)
            || ip_of(&named).is_some_and(|ip| ip.is_loopback())
            || authority(host).is_some_and(|own| own.host() == named.host())
    });
    if is_here {
        Ok(())
    } else {
        Err(origin.to_owned())
    }
}

/// Whether a header has this word in its list.
fn has_word(headers: &HeaderMap, name: &HeaderName, word: &str) -> bool {
    let values = headers
        .get_all(name)
        .iter()
        .filter_map(|value| value.to_str().ok());
    values
        .flat_map(|value| value.split(','))
        .any(|one| one.trim().eq_ignore_ascii_case(word))
}

/// What the page may do: only what its own files say, with this server alone.
fn secure(headers: &mut HeaderMap, host: &str) {
    let policy = format!(
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self' ws://{host}; img-src 'self'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    if let Ok(policy) = HeaderValue::try_from(policy) {
        headers.insert(CONTENT_SECURITY_POLICY, policy);
    }
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    // A connection is for one request.
    if !headers.contains_key(UPGRADE) {
        headers.insert(CONNECTION, HeaderValue::from_static("close"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_is_what_is_listened_on_or_localhost() {
        let loopback = "127.0.0.1:9178".parse().unwrap();
        for host in [
            "127.0.0.1:9178",
            "localhost:9178",
            "LocalHost:9178",
            "localhost:8080",
            "localhost",
        ] {
            assert!(is_own(host, loopback), "{host}");
        }
        for host in [
            "127.0.0.2:9178",
            "10.0.0.7:9178",
            "evil.example:9178",
            "localhost.evil.example:9178",
            "a@127.0.0.1:9178",
            "[::1]:9178",
            "",
            "a b",
        ] {
            assert!(!is_own(host, loopback), "{host}");
        }
        let public = "0.0.0.0:9178".parse().unwrap();
        assert!(is_own("10.0.0.7:9178", public));
        assert!(!is_own("evil.example:9178", public));
        assert!(is_own("[::1]:9178", "[::1]:9178".parse().unwrap()));
    }

    #[test]
    fn only_the_page_itself_is_an_origin() {
        let is_origin = |origins: &[&str]| {
            let mut headers = HeaderMap::new();
            for origin in origins {
                headers.append(ORIGIN, HeaderValue::from_str(origin).unwrap());
            }
            is_origin(&headers, "localhost:9178")
        };
        assert!(is_origin(&["http://localhost:9178"]));
        for origins in [
            &[][..],
            &["null"],
            &["http://127.0.0.1:9178"],
            &["http://localhost:9179"],
            &["http://localhost"],
            &["https://localhost:9178"],
            &["http://evil.example"],
            &["http://localhost:9178", "http://evil.example"],
        ] {
            assert!(!is_origin(origins), "{origins:?}");
        }
    }
}
