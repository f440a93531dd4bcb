//! One GET request with limits of size and time.

use std::net::SocketAddr;
use std::time::Duration;

use http_body_util::{BodyExt, Empty, Limited};
use hyper::body::Bytes;
use hyper::header::{ACCEPT, CONNECTION, HOST};
use hyper::{Request, client::conn::http1};
use hyper_util::rt::TokioIo;
use serde_json::Value;
use tokio::net::TcpStream;

/// Bytes of an answer at most.
const LIMIT: usize = 1 << 20;

/// The JSON at a path, with any status. The error says in a few words why there is none.
pub(super) async fn get_json(
    to: SocketAddr,
    path: &str,
    patience: Duration,
) -> Result<Value, String> {
    let answer = tokio::time::timeout(patience, get(to, path)).await;
    let bytes = answer
        .unwrap_or_else(|_| Err(format!("no answer within {:.1} s", patience.as_secs_f64())))?;
    serde_json::from_slice(&bytes).map_err(|error| format!("the answer is no JSON: {error}"))
}

async fn get(to: SocketAddr, path: &str) -> Result<Bytes, String> {
    let stream = TcpStream::connect(to)
        .await
        .map_err(|error| error.to_string())?;
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream))
        .await
        .map_err(|error| error.to_string())?;
    let request = Request::get(path)
        .header(HOST, to.to_string())
        .header(ACCEPT, "application/json")
        .header(CONNECTION, "close")
        .body(Empty::<Bytes>::new())
        .map_err(|error| error.to_string())?;
    let exchange = async move {
        let response = sender
            .send_request(request)
            .await
            .map_err(|error| error.to_string())?;
        let body = Limited::new(response.into_body(), LIMIT)
            .collect()
            .await
            .map_err(|error| error.to_string())?;
        Ok(body.to_bytes())
    };
    // The connection moves the bytes while the exchange waits for them.
    tokio::pin!(exchange, connection);
    tokio::select! {
        done = &mut exchange => done,
        broken = &mut connection => match broken {
            Err(error) => Err(error.to_string()),
            Ok(()) => exchange.await,
        },
    }
}

/// A runtime for a few requests.
pub(super) fn runtime() -> std::io::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
}
