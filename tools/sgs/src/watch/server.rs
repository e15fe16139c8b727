//! The page, on this machine and for it alone.
//!
//! Promises: listens on 127.0.0.1 and nowhere else; answers nobody who asked for another host's name, as a page elsewhere
//! would have a browser do; changes nothing, and ends with the value.

use super::board::Board;
use anyhow::anyhow;
use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use tiny_http::{Header, Method, Request, Response, Server};

/// The server, with its thread.
pub struct Serving {
    server: Arc<Server>,
    thread: Option<JoinHandle<()>>,
}

/// A port that is taken before anything begins.
pub struct Port(TcpListener, SocketAddr);

impl Port {
    /// Takes a port; 0 is any that is free.
    pub fn take(port: u16) -> anyhow::Result<Port> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(|e| match e.kind() {
            ErrorKind::AddrInUse => {
                anyhow!("Port {port} is in use; give another one with --watch=PORT, or --watch=0 for any that is free.")
            }
            _ => anyhow!("Port {port} cannot be listened on: {e}."),
        })?;
        let address = listener.local_addr()?;
        Ok(Port(listener, address))
    }

    /// Where the page is.
    pub fn address(&self) -> String {
        format!("http://{}/", self.1)
    }

    /// Begins to answer.
    pub fn serve(self, board: Arc<Board>) -> anyhow::Result<Serving> {
        let Port(listener, address) = self;
        let server = Server::from_listener(listener, None).map_err(|e| anyhow!("The page cannot be served: {e}."))?;
        let server = Arc::new(server);
        let asked = server.clone();
        let thread = std::thread::Builder::new().name("watch".into()).spawn(move || {
            for request in asked.incoming_requests() {
                answer(request, &board, address.port());
            }
        })?;
        Ok(Serving { server, thread: Some(thread) })
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        self.server.unblock();
        if let Some(thread) = self.thread.take() {
            let _ended = thread.join();
        }
    }
}

/// Whether a request means this machine by its own name.
fn is_ours(host: Option<&str>, port: u16) -> bool {
    let Some((name, given)) = host.and_then(|h| h.rsplit_once(':')) else { return false };
    ["127.0.0.1", "localhost"].contains(&name) && given.parse() == Ok(port)
}

/// How many pictures somebody has seen who asks for changes.
fn seen(query: &str) -> u64 {
    query.split('&').find_map(|p| p.strip_prefix("pictures=")?.parse().ok()).unwrap_or(0)
}

fn answer(request: Request, board: &Board, port: u16) {
    let host = request.headers().iter().find(|h| h.field.equiv("Host")).map(|h| h.value.as_str());
    let (path, query) = request.url().split_once('?').unwrap_or((request.url(), ""));
    let (status, kind, body) = if !is_ours(host, port) {
        (403, "text/plain", "This page is for this machine alone.\n".to_owned())
    } else if !matches!(request.method(), Method::Get | Method::Head) {
        (405, "text/plain", "There is nothing to be changed here.\n".to_owned())
    } else {
        match path {
            "/" => (200, "text/html; charset=utf-8", board.page()),
            "/live" => (200, "application/json", board.changes(seen(query))),
            _ => (404, "text/plain", "There is nothing here.\n".to_owned()),
        }
    };
    let mut response = Response::from_string(body).with_status_code(status);
    for (field, value) in [("Content-Type", kind), ("Cache-Control", "no-store"), ("X-Content-Type-Options", "nosniff")]
    {
        if let Ok(header) = Header::from_bytes(field, value) {
            response.add_header(header);
        }
    }
    // Whoever has gone away meanwhile misses nothing.
    let _gone = request.respond(response);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};
    use std::net::TcpStream;

    fn ask(port: u16, text: &str) -> String {
        let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).expect("a connection");
        stream.write_all(text.as_bytes()).expect("it listens");
        let mut said = String::new();
        stream.read_to_string(&mut said).expect("an answer");
        said
    }

    #[test]
    fn it_answers_this_machine_alone_and_ends() {
        let port = Port::take(0).expect("a port");
        let number = port.1.port();
        assert!(port.1.ip().is_loopback() && port.address() == format!("http://127.0.0.1:{number}/"));
        let taken = Port::take(number).err().expect("it is taken").to_string();
        assert!(taken.contains("in use") && taken.contains(&number.to_string()), "{taken}");
        let board = Arc::new(Board::new("t".into(), "none".into(), Vec::new()));
        let serving = port.serve(board).expect("it serves");
        let get = |path: &str, host: &str| {
            ask(number, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"))
        };
        let ours = format!("127.0.0.1:{number}");
        assert!(get("/", &ours).contains("200 OK") && get("/", &format!("localhost:{number}")).contains("<!doctype"));
        assert!(get("/live?pictures=0", &ours).contains("\"pictures\":0"));
        assert!(get("/none", &ours).contains("404"));
        for host in ["elsewhere.example", "elsewhere.example:80", &format!("elsewhere.example:{number}"), ""] {
            assert!(get("/", host).contains("403"), "{host}");
        }
        let post = format!("POST / HTTP/1.1\r\nHost: {ours}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
        assert!(ask(number, &post).contains("405"));
        drop(serving);
        // The library's own thread lets the port go when it next runs, which on a busy machine takes its time.
        let freed = (0..600).any(|_| {
            let free = Port::take(number).is_ok();
            if !free {
                std::thread::sleep(std::time::Duration::from_millis(100));
            }
            free
        });
        assert!(freed, "the port is still taken after a minute");
    }
}
