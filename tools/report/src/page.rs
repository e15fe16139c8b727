//! The page around everything: one file, nothing fetched.

use crate::text::escape;

/// A page: a title and sections under headings.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    sections: Vec<(String, String, String)>,
}

impl Page {
    /// Without sections.
    pub fn new(title: &str) -> Page {
        Page { title: title.to_owned(), sections: Vec::new() }
    }

    /// Adds a section with a heading; `html` stands as it is. What is empty is left out.
    pub fn section(&mut self, id: &str, heading: &str, html: String) {
        if !html.is_empty() {
            self.sections.push((id.to_owned(), heading.to_owned(), html));
        }
    }

    /// The file. Its policy lets the browser take pictures from the page itself and nothing from elsewhere.
    pub fn html(&self) -> String {
        let title = escape(&self.title);
        let mut out = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src \
             'unsafe-inline'; script-src 'unsafe-inline'\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n<link rel=\"icon\" href=\"data:,\">\n\
             <style>\n{}</style>\n</head>\n<body>\n<header><h1>{title}</h1>\n<nav>",
            include_str!("page.css")
        );
        for (id, heading, _) in &self.sections {
            out.push_str(&format!("<a href=\"#{}\">{}</a>\n", escape(id), escape(heading)));
        }
        out.push_str("</nav></header>\n<main>\n");
        for (id, heading, html) in &self.sections {
            out.push_str(&format!("<section id=\"{}\"><h2>{}</h2>\n{html}</section>\n", escape(id), escape(heading)));
        }
        out.push_str(&format!("</main>\n<script>\n{}</script>\n</body>\n</html>\n", include_str!("page.js")));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_names_nothing_outside_of_itself() {
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
}
