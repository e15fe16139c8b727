//! HTTP server for pages on this machine.
//!
//! Guarantees: the server listens only on 127.0.0.1. It rejects requests that name another host, as a page from
//! elsewhere could make a browser send. Any port of this machine is accepted, since ports may be forwarded. Requests
//! change nothing.
//!
//! Limits: 16 KiB per request, 5 seconds to receive it, one minute to send the response, and 16 connections at a time;
//! further ones are closed. Shutdown does not wait for connections.

use httparse::{EMPTY_HEADER, Error, Request, Status};
use std::fmt::Write as _;
use std::io::{ErrorKind, Read, Result, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Maximum bytes of a request before it is rejected.
const MOST_BYTES: usize = 16 << 10;

/// Maximum number of headers of a request.
const MOST_HEADERS: usize = 64;

/// Maximum number of concurrent connections.
const AT_ONCE: usize = 16;

/// Time limit for receiving a request.
const PATIENCE: Duration = Duration::from_secs(5);

/// Time limit for sending a response.
const TAKEN: Duration = Duration::from_secs(60);

/// Time limit for draining a request after its response.
///
/// Closing with unread data would reset the connection before the client reads the response.
const FAREWELL: Duration = Duration::from_secs(1);

/// Content at a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Content {
    /// Media type.
    pub kind: &'static str,
    /// Response body.
    pub body: String,
}

/// Reserved port, not yet served.
#[derive(Debug)]
pub struct Port(TcpListener, SocketAddr);

impl Port {
    /// Reserves a port; 0 chooses any free one.
    ///
    /// # Errors
    /// If the port is unavailable; [`ErrorKind::AddrInUse`] if another process uses it.
    pub fn take(port: u16) -> Result<Port> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
        let address = listener.local_addr()?;
        Ok(Port(listener, address))
    }

    /// Returns the URL of the pages.
    pub fn address(&self) -> String {
        format!("http://{}/", self.1)
    }

    /// Starts to serve pages; `pages` maps a path and a query to content.
    ///
    /// Calls to `pages` are serialized.
    ///
    /// # Errors
    /// If the thread cannot be created.
    pub fn serve(self, pages: impl Fn(&str, &str) -> Option<Content> + Send + 'static) -> Result<Serving> {
        let Port(listener, address) = self;
        let over = Arc::new(AtomicBool::new(false));
        let ends = over.clone();
        let pages = Arc::new(Mutex::new(pages));
        let seat = Arc::new(());
        let thread = thread::Builder::new().name("pages".into()).spawn(move || {
            for stream in listener.incoming() {
                if ends.load(Ordering::Acquire) {
                    return;
                }
                let Ok(stream) = stream else {
                    // The process may have no file descriptor left.
                    thread::sleep(Duration::from_millis(50));
                    continue;
                };
                if Arc::strong_count(&seat) > AT_ONCE {
                    continue;
                }
                let (seat, pages) = (seat.clone(), pages.clone());
                let attend = move || {
                    let pages =
                        |path: &str, query: &str| pages.lock().unwrap_or_else(PoisonError::into_inner)(path, query);
                    // A client that disconnected needs no error.
                    let _gone = attend(stream, pages);
                    drop(seat);
                };
                // Without a thread, the request gets no response.
                let _unattended = thread::Builder::new().name("page".into()).spawn(attend);
            }
        })?;
        Ok(Serving { over, address, thread: Some(thread) })
    }
}

/// Running server; dropping it stops serving.
#[derive(Debug)]
pub struct Serving {
    over: Arc<AtomicBool>,
    address: SocketAddr,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Serving {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Release);
        // The thread blocks in accept until a connection arrives.
        let came = TcpStream::connect_timeout(&self.address, PATIENCE).is_ok();
        if let Some(thread) = self.thread.take().filter(|_| came) {
            let _ended = thread.join();
        }
    }
}

/// Reads a request and sends the response.
fn attend(mut stream: TcpStream, pages: impl Fn(&str, &str) -> Option<Content>) -> Result<()> {
    let mut buffer = [0; 4096];
    let mut request = Vec::new();
    let until = Instant::now() + PATIENCE;
    let answer = loop {
        // Never zero: a full request would have been answered.
        let room = buffer.len().min(MOST_BYTES - request.len());
        match read(&mut stream, &mut buffer[..room], until)? {
            0 => return Ok(()),
            count => request.extend_from_slice(&buffer[..count]),
        }
        if let Some(answer) = respond(&request, &pages) {
            break answer;
        }
    };
    let until = Instant::now() + TAKEN;
    let mut rest = &answer[..];
    while !rest.is_empty() {
        stream.set_write_timeout(Some(left(until)?))?;
        match stream.write(rest) {
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
            Ok(0) => return Ok(()),
            Ok(count) => rest = &rest[count..],
        }
    }
    stream.shutdown(std::net::Shutdown::Write)?;
    let until = Instant::now() + FAREWELL;
    while read(&mut stream, &mut buffer, until)? > 0 {}
    Ok(())
}

fn read(stream: &mut TcpStream, buffer: &mut [u8], until: Instant) -> Result<usize> {
    loop {
        stream.set_read_timeout(Some(left(until)?))?;
        match stream.read(buffer) {
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            read => return read,
        }
    }
}

/// Returns the time left until `until`, or an error after it.
fn left(until: Instant) -> Result<Duration> {
    let left = until.saturating_duration_since(Instant::now());
    if left.is_zero() { Err(ErrorKind::TimedOut.into()) } else { Ok(left) }
}

/// Returns the response to the received part of a request; `None` until its header is complete.
///
/// Ignores request bodies.
pub fn respond(request: &[u8], pages: impl Fn(&str, &str) -> Option<Content>) -> Option<Vec<u8>> {
    let mut headers = [EMPTY_HEADER; MOST_HEADERS];
    let mut requested = Request::new(&mut headers);
    let plain = |text: &str| Content { kind: "text/plain", body: format!("{text}\n") };
    let parsed = requested.parse(request);
    let (method, target) = (requested.method.unwrap_or_default(), requested.path.unwrap_or_default());
    let refused = |status: &str, text: &str| Some(response(status, &plain(text), method != "HEAD"));
    match parsed {
        Ok(Status::Complete(_)) => {}
        Ok(Status::Partial) if request.len() < MOST_BYTES => return None,
        Ok(Status::Partial) | Err(Error::TooManyHeaders) => {
            return refused("431 Request Header Fields Too Large", "This is more than anybody has to say here.");
        }
        Err(_) => return refused("400 Bad Request", "This is not understood."),
    }
    let mut hosts = requested.headers.iter().filter(|h| h.name.eq_ignore_ascii_case("host"));
    let ours = hosts.next().is_some_and(|h| is_ours(h.value)) && hosts.next().is_none();
    if !ours {
        return refused("403 Forbidden", "This page is for this machine alone.");
    }
    if !["GET", "HEAD"].contains(&method) {
        return refused("405 Method Not Allowed", "There is nothing to be changed here.");
    }
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let (status, content) = match pages(path, query) {
        Some(content) => ("200 OK", content),
        None => ("404 Not Found", plain("There is nothing here.")),
    };
    Some(response(status, &content, method != "HEAD"))
}

/// Returns whether a `Host` header names this machine.
///
/// The port may differ, because ports may be forwarded.
fn is_ours(host: &[u8]) -> bool {
    let Ok(host) = std::str::from_utf8(host) else { return false };
    let (name, port) = host.split_once(':').unwrap_or((host, "80"));
    ["127.0.0.1", "localhost"].contains(&name) && port.parse::<u16>().is_ok()
}

/// Formats a response that closes the connection.
fn response(status: &str, content: &Content, whole: bool) -> Vec<u8> {
    let mut text = format!("HTTP/1.1 {status}\r\n");
    let length = content.body.len().to_string();
    for (name, value) in [
        ("Content-Type", content.kind),
        ("Content-Length", &length),
        ("Cache-Control", "no-store"),
        ("X-Content-Type-Options", "nosniff"),
        ("Connection", "close"),
    ] {
        let _ = write!(text, "{name}: {value}\r\n");
    }
    if status.starts_with("405") {
        text += "Allow: GET, HEAD\r\n";
    }
    text += "\r\n";
    if whole {
        text += &content.body;
    }
    text.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pages(path: &str, query: &str) -> Option<Content> {
        match path {
            "/" => Some(Content { kind: "text/html; charset=utf-8", body: format!("<!doctype html>{query}") }),
            "/large" => Some(Content { kind: "text/plain", body: "0123456789abcdef".repeat(1 << 20) }),
            _ => None,
        }
    }

    fn connect(port: u16) -> TcpStream {
        TcpStream::connect((Ipv4Addr::LOCALHOST, port)).expect("a connection")
    }

    /// Sends a text and returns the response, with the sending side held open.
    fn ask(port: u16, text: &str) -> String {
        let mut stream = connect(port);
        stream.write_all(text.as_bytes()).expect("it listens");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        answer
    }

    fn get(port: u16, path: &str, more: &str) -> String {
        format!("GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{more}\r\n")
    }

    /// Starts a server on a free port and returns its number.
    fn served() -> (Serving, u16) {
        let port = Port::take(0).expect("a port");
        let number = port.1.port();
        assert!(port.1.ip().is_loopback() && port.address() == format!("http://127.0.0.1:{number}/"));
        (port.serve(pages).expect("it serves"), number)
    }

    #[test]
    fn server_answers_only_local_hosts_and_stops() {
        let (serving, port) = served();
        assert_eq!(Port::take(port).expect_err("it is taken").kind(), ErrorKind::AddrInUse);
        let whole = ask(port, &get(port, "/?a=1", ""));
        assert!(whole.starts_with("HTTP/1.1 200 OK\r\n") && whole.ends_with("\r\n\r\n<!doctype html>a=1"), "{whole}");
        assert!(whole.contains("Content-Length: 18\r\n") && whole.contains("no-store") && whole.contains("nosniff"));
        assert!(ask(port, &get(port, "/none", "")).contains("404"));
        let with = |host: &str| ask(port, &format!("GET / HTTP/1.1\r\n{host}\r\n"));
        let forwarded = port ^ 1;
        for host in ["localhost".into(), format!("localhost:{port}"), format!("127.0.0.1:{forwarded}")] {
            assert!(with(&format!("hOST: {host}\r\n")).contains("200 OK"), "{host}");
        }
        let elsewhere = [
            "Host: elsewhere.example\r\n".to_owned(),
            format!("Host: elsewhere.example:{port}\r\n"),
            format!("Host: localhost:{port}\r\nHost: elsewhere.example\r\n"),
            format!("Host: localhost.elsewhere.example:{port}\r\n"),
            "Host: localhost:x\r\n".to_owned(),
            "Host: localhost:1:2\r\n".to_owned(),
            "Host: \u{e9}\r\n".to_owned(),
            String::new(),
        ];
        for host in elsewhere {
            assert!(with(&host).contains("403"), "{host}");
        }
        let head = ask(port, &get(port, "/", "").replace("GET", "HEAD"));
        assert!(head.contains("200 OK") && head.contains("Content-Length: 15") && head.ends_with("\r\n\r\n"), "{head}");
        let post = ask(port, &get(port, "/", "").replace("GET", "POST"));
        assert!(post.contains("405") && post.contains("Allow: GET, HEAD"), "{post}");
        let head = ask(port, "HEAD / HTTP/1.1\r\n\r\n");
        assert!(head.contains("403") && head.ends_with("\r\n\r\n"), "{head}");
        drop(serving);
        assert!(Port::take(port).is_ok(), "the port is still taken");
    }

    #[test]
    fn malformed_requests_do_not_stop_the_server() {
        let (serving, port) = served();
        let lives = || assert!(ask(port, &get(port, "/", "")).contains("200 OK"), "it answers nobody any more");
        // Bodies that never arrive, with invalid or huge sizes.
        for length in ["5", "4096", "99999999999999", "18446744073709551615", "-1", "x"] {
            let answer = ask(port, &get(port, "/", &format!("Content-Length: {length}\r\n")));
            assert!(answer.contains("200 OK"), "{length}: {answer}");
        }
        let chunked = get(port, "/", "Transfer-Encoding: chunked\r\n") + "ffffffffffffffff\r\n";
        assert!(ask(port, &chunked).contains("200 OK"));
        assert!(ask(port, &get(port, "/", "Expect: 100-continue\r\n")).contains("200 OK"));
        lives();
        // Malformed or oversized requests.
        assert!(ask(port, "\u{0}\u{1}\u{2}\r\n\r\n").contains("400"));
        assert!(ask(port, "GET /\u{0} HTTP/1.1\r\n\r\n").contains("400"));
        assert!(ask(port, "GET / HTTP/9.9\r\n\r\n").contains("400"));
        assert!(ask(port, &get(port, &"/a".repeat(MOST_BYTES), "")).contains("431"));
        assert!(ask(port, &"GET ".repeat(MOST_BYTES)).contains("400"));
        assert!(ask(port, &get(port, "/", &"a: b\r\n".repeat(MOST_HEADERS))).contains("431"));
        lives();
        // Clients that send or read nothing are limited in number, and shutdown does not wait for them.
        let requested = |path: &str| -> Option<TcpStream> {
            let (mut stream, mut status) = (connect(port), [0; 15]);
            let sent = stream.write_all(get(port, path, "").as_bytes());
            sent.and_then(|()| stream.read_exact(&mut status))
                .is_ok_and(|()| status == *b"HTTP/1.1 200 OK")
                .then_some(stream)
        };
        // A connection that was answered before can hold its place for a moment.
        let admitted = |path: &str| -> TcpStream {
            let begun = Instant::now();
            loop {
                match requested(path) {
                    Some(stream) => return stream,
                    None => assert!(begun.elapsed() < PATIENCE / 2, "those who have gone leave no room"),
                }
            }
        };
        let mut unread: Vec<TcpStream> = (2..AT_ONCE).map(|_| admitted("/large")).collect();
        // A silent client has its place until its time is over: on a slow machine it is tried again.
        let begun = Instant::now();
        let _silent = loop {
            let (silent, last) = (connect(port), admitted("/large"));
            let full = requested("/").is_none();
            silent.set_nonblocking(true).expect("a mode");
            let held = silent.peek(&mut [0]).is_err_and(|e| e.kind() == ErrorKind::WouldBlock);
            assert!(full || !held, "there is room for one too many");
            if held {
                unread.push(last);
                break silent;
            }
            assert!(begun.elapsed() < 4 * PATIENCE, "a silent client has no place");
        };
        unread.truncate(4);
        admitted("/");
        let begun = Instant::now();
        drop(serving);
        assert!(begun.elapsed() < PATIENCE / 2, "it waited for somebody");
        assert!(Port::take(port).is_ok(), "the port is still taken");
        // A started response completes.
        let mut large = String::new();
        unread[0].read_to_string(&mut large).expect("an answer");
        assert!(large.len() > 16 << 20 && large.ends_with("89abcdef"), "{} bytes", large.len());
    }

    #[test]
    fn incomplete_requests_time_out() {
        let (_serving, port) = served();
        let begun = Instant::now();
        let mut stream = connect(port);
        // Sending single bytes does not extend the time limit.
        stream.set_read_timeout(Some(PATIENCE / 10)).expect("a time");
        let mut head = b"GET / HTTP/1.1\r\na: ".iter().chain(std::iter::repeat(&b'b'));
        let ended = loop {
            assert!(begun.elapsed() < 3 * PATIENCE, "it is still listened to");
            let sent = stream.write_all(&[*head.next().expect("there is no end")]);
            match stream.read(&mut [0]) {
                Err(e) if sent.is_ok() && matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                ended => break ended.unwrap_or(0),
            }
        };
        assert!(ended == 0 && begun.elapsed() >= PATIENCE, "{:?}", begun.elapsed());
    }
}
