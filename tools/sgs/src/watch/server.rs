//! What there is to be asked for at which path.

use super::board::Board;
use anyhow::anyhow;
use sgs_report::serve::{self, Content, Serving};
use std::io::ErrorKind;
use std::sync::Arc;

/// A port that is taken before anything begins.
pub struct Port(serve::Port);

impl Port {
    /// Takes a port; 0 is any that is free.
    pub fn take(port: u16) -> anyhow::Result<Port> {
        let taken = serve::Port::take(port).map_err(|e| match e.kind() {
            ErrorKind::AddrInUse => {
                anyhow!("Port {port} is in use; give another one with --watch=PORT, or --watch=0 for any that is free.")
            }
            _ => anyhow!("Port {port} cannot be listened on: {e}."),
        });
        Ok(Port(taken?))
    }

    /// Where the page is.
    pub fn address(&self) -> String {
        self.0.address()
    }

    /// Begins to answer.
    pub fn serve(self, board: Arc<Board>) -> anyhow::Result<Serving> {
        let pages = move |path: &str, query: &str| content(&board, path, query);
        self.0.serve(pages).map_err(|e| anyhow!("The page cannot be served: {e}."))
    }
}

fn content(board: &Board, path: &str, query: &str) -> Option<Content> {
    match path {
        "/" => Some(Content { kind: "text/html; charset=utf-8", body: board.page() }),
        "/live" => Some(Content { kind: "application/json", body: board.changes(seen(query)) }),
        _ => None,
    }
}

/// How many pictures somebody has seen who asks for changes.
fn seen(query: &str) -> u64 {
    query.split('&').find_map(|p| p.strip_prefix("pictures=")?.parse().ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_a_page_and_what_has_changed() {
        let board = Board::new("t".into(), "none".into(), Vec::new());
        let at = |path: &str, query: &str| content(&board, path, query).map(|c| (c.kind, c.body));
        assert!(at("/", "").is_some_and(|(kind, body)| kind.starts_with("text/html") && body.contains("<!doctype")));
        for query in ["", "pictures=0", "a=1&pictures=0", "pictures=-1", "pictures=99999999999999999999"] {
            let changes = at("/live", query).expect("it is there");
            assert!(changes.0 == "application/json" && changes.1.contains("\"pictures\":0"), "{query}: {changes:?}");
        }
        assert!(at("/live", "pictures=7").is_some_and(|(_, body)| body.contains("\"pictures\":0")));
        assert_eq!(at("/none", ""), None);
    }

    #[test]
    fn a_port_that_is_taken_is_named() {
        let port = Port::take(0).expect("a port");
        let number: u16 = port.address().trim_end_matches('/').rsplit(':').next().unwrap().parse().unwrap();
        let taken = Port::take(number).err().expect("it is taken").to_string();
        assert!(taken.contains("in use") && taken.contains(&number.to_string()), "{taken}");
    }
}
