//! One request with limits of size and time.

use std::net::SocketAddr;
use std::time::Duration;

use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1;
use hyper::header::{ACCEPT, CONNECTION, CONTENT_TYPE, HOST};
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use serde_json::Value;
use tokio::net::TcpStream;

use super::CommandError;

/// Bytes of an answer at most.
const LIMIT: usize = 1 << 20;

/// The JSON at a path, with any status. The error says in a few words why there is none.
pub(crate) async fn get_json(
    to: SocketAddr,
    path: &str,
    patience: Duration,
) -> Result<Value, String> {
    let get = async {
        let stream = connect(to).await?;
        let request = request(
            to,
            Request::get(path).header(ACCEPT, "application/json"),
            "",
        )?;
        exchange(stream, request, body).await
    };
    let answer = tokio::time::timeout(patience, get).await;
    let bytes = answer.unwrap_or_else(|_| Err(silence(patience)))?;
    serde_json::from_slice(&bytes).map_err(|error| format!("the answer is no JSON: {error}"))
}

/// Sends a form; the status of the answer, whose body is not read.
pub(super) async fn post_form(
    to: SocketAddr,
    path: &str,
    form: String,
    patience: Duration,
) -> Result<StatusCode, CommandError> {
    let connecting = tokio::time::timeout(patience, connect(to)).await;
    let stream = connecting
        .unwrap_or_else(|_| Err(silence(patience)))
        .map_err(CommandError::NotSent)?;
    let post = Request::post(path).header(CONTENT_TYPE, "application/x-www-form-urlencoded");
    let request = request(to, post, form).map_err(CommandError::NotSent)?;
    let answer = tokio::time::timeout(patience, exchange(stream, request, status)).await;
    answer
        .unwrap_or_else(|_| Err(silence(patience)))
        .map_err(CommandError::Unknown)
}

fn silence(patience: Duration) -> String {
    format!("no answer within {:.1} s", patience.as_secs_f64())
}

async fn connect(to: SocketAddr) -> Result<TcpStream, String> {
    TcpStream::connect(to).await.map_err(words)
}

fn request(
    to: SocketAddr,
    head: hyper::http::request::Builder,
    body: impl Into<Bytes>,
) -> Result<Request<Full<Bytes>>, String> {
    head.header(HOST, to.to_string())
        .header(CONNECTION, "close")
        .body(Full::new(body.into()))
        .map_err(words)
}

async fn body(response: Response<Incoming>) -> Result<Bytes, String> {
    let body = Limited::new(response.into_body(), LIMIT).collect().await;
    Ok(body.map_err(words)?.to_bytes())
}

async fn status(response: Response<Incoming>) -> Result<StatusCode, String> {
    Ok(response.status())
}

/// Sends a request, and gives what `read` makes of the answer.
async fn exchange<T>(
    stream: TcpStream,
    request: Request<Full<Bytes>>,
    read: impl AsyncFnOnce(Response<Incoming>) -> Result<T, String>,
) -> Result<T, String> {
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream))
        .await
        .map_err(words)?;
    let exchange = async move { read(sender.send_request(request).await.map_err(words)?).await };
    // The connection moves the bytes while the exchange waits for them.
    tokio::pin!(exchange, connection);
    tokio::select! {
        done = &mut exchange => done,
        broken = &mut connection => match broken {
            Err(error) => Err(words(error)),
            Ok(()) => exchange.await,
        },
    }
}

fn words(error: impl ToString) -> String {
    error.to_string()
}

/// A runtime for a few requests.
pub(crate) fn runtime() -> std::io::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
}
