//! HTML page in one file that fetches nothing.

use crate::text::escape;

/// Page: a title and sections under headings.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    sections: Vec<(String, String, String)>,
}

impl Page {
    /// Creates a page without sections.
    pub fn new(title: &str) -> Page {
        Page { title: title.to_owned(), sections: Vec::new() }
    }

    /// Adds a section with a heading; `html` is inserted verbatim. Skips empty sections.
    pub fn section(&mut self, id: &str, heading: &str, html: String) {
        if !html.is_empty() {
            self.sections.push((id.to_owned(), heading.to_owned(), html));
        }
    }

    /// Adds a section that a server updates later ([`Page::live`]).
    pub fn live_section(&mut self, id: &str, heading: &str, html: &str) {
        self.section(id, heading, format!("<div class=\"live\">{html}</div>\n"));
    }

    /// Returns the HTML file.
    ///
    /// Its content security policy allows only images within the page and no requests.
    pub fn html(&self) -> String {
        self.with("", "")
    }

    /// Returns the page for a server that keeps it up to date.
    ///
    /// The page polls `live?images=N` on that server only. The response is
    /// `{"parts": {"id": "html"}, "images": N, "ended": bool}`; the page replaces the
    /// sections in `parts`. Polling stops once `ended` is true, or after three requests without a response.
    pub fn live(&self) -> String {
        self.with("; connect-src 'self'", include_str!("live.js"))
    }

    fn with(&self, policy: &str, script: &str) -> String {
        let title = escape(&self.title);
        let mut out = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src \
             'unsafe-inline'; script-src 'unsafe-inline'{policy}\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n<link rel=\"icon\" href=\"data:,\">\n\
             <style>\n{}</style>\n</head>\n<body>\n<header><h1>{title}</h1></header>\n<nav aria-label=\"Sections\">",
            include_str!("page.css")
        );
        for (id, heading, _) in &self.sections {
            out.push_str(&format!("<a href=\"#{}\">{}</a>\n", escape(id), escape(heading)));
        }
        out.push_str("</nav>\n<main>\n");
        for (id, heading, html) in &self.sections {
            out.push_str(&format!("<section id=\"{}\"><h2>{}</h2>\n{html}</section>\n", escape(id), escape(heading)));
        }
        let ours = include_str!("page.js");
        out.push_str(&format!("</main>\n<script>\n{ours}{script}</script>\n</body>\n</html>\n"));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_references_no_external_resource() {
        let mut page = Page::new("a <run>");
        page.section("one", "One & all", "<p>x</p>\n".into());
        page.section("two", "Two", String::new());
        let html = page.html();
        for word in ["http:", "https:", "://", "url(", "@import", "fetch(", "XMLHttp", "a <run>"] {
            assert!(!html.contains(word), "{word}");
        }
        assert!(html.contains("a &lt;run&gt;") && html.contains("<a href=\"#one\">One &amp; all</a>"));
        assert!(html.contains("default-src 'none'") && !html.contains("Two"));
    }

    #[test]
    fn live_page_connects_only_to_its_own_server() {
        let mut page = Page::new("run");
        page.live_section("one", "One", "");
        let html = page.live();
        assert!(html.contains("connect-src 'self'") && html.contains("fetch(\"live?"), "{html}");
        for word in ["http:", "https:", "://", "url(", "@import", "XMLHttp"] {
            assert!(!html.contains(word), "{word}");
        }
        assert!(html.contains("<section id=\"one\"><h2>One</h2>\n<div class=\"live\"></div>"));
    }
}
