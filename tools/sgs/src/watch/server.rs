//! Routes of the live page.

use super::board::Board;
use anyhow::anyhow;
use sgs_report::serve::{self, Content, Serving};
use std::io::ErrorKind;
use std::sync::Arc;

/// Port that is bound before the training begins.
pub struct Port(serve::Port);

impl Port {
    /// Binds a port; 0 selects any free port.
    pub fn take(port: u16) -> anyhow::Result<Port> {
        let taken = serve::Port::take(port).map_err(|e| match e.kind() {
            ErrorKind::AddrInUse => {
                anyhow!("Port {port} is in use; give another one with --watch=PORT, or --watch=0 for any that is free.")
            }
            _ => anyhow!("Port {port} cannot be listened on: {e}."),
        });
        Ok(Port(taken?))
    }

    /// Returns the URL of the page.
    pub fn address(&self) -> String {
        self.0.address()
    }

    /// Starts to serve the page of `board`.
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

/// Parses the number of image sets that the client has received from the query.
fn seen(query: &str) -> u64 {
    query.split('&').find_map(|p| p.strip_prefix("images=")?.parse().ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_and_changes_are_served() {
        let board = Board::new("t".into(), "none".into(), Vec::new());
        let at = |path: &str, query: &str| content(&board, path, query).map(|c| (c.kind, c.body));
        assert!(at("/", "").is_some_and(|(kind, body)| kind.starts_with("text/html") && body.contains("<!doctype")));
        for query in ["", "images=0", "a=1&images=0", "images=-1", "images=99999999999999999999"] {
            let changes = at("/live", query).expect("it is there");
            assert!(changes.0 == "application/json" && changes.1.contains("\"images\":0"), "{query}: {changes:?}");
        }
        assert!(at("/live", "images=7").is_some_and(|(_, body)| body.contains("\"images\":0")));
        assert_eq!(at("/none", ""), None);
    }

    #[test]
    fn error_names_a_port_in_use() {
        let port = Port::take(0).expect("a port");
        let number: u16 = port.address().trim_end_matches('/').rsplit(':').next().unwrap().parse().unwrap();
        let taken = Port::take(number).err().expect("it is taken").to_string();
        assert!(taken.contains("in use") && taken.contains(&number.to_string()), "{taken}");
    }
}
