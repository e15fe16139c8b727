//! HTML page: well-formed, complete, escaped, self-contained.

use proptest::prelude::*;
use roxmltree::{Document, Node, ParsingOptions};

use super::kernels::pass;
use super::random::recipes;
use super::snapshot::step;
use super::*;
use crate::graph::dump::PassTime;
use crate::shader::Access::{Read, ReadWrite, Write};

/// Parses as XML, which is stricter than HTML: closed elements, quoted attributes, escaped names.
fn parse(page: &str) -> Result<Document<'_>, roxmltree::Error> {
    Document::parse_with_options(page, ParsingOptions { allow_dtd: true, ..ParsingOptions::default() })
}

fn with_id<'a, 'd>(page: &'a Document<'d>, id: &str) -> Option<Node<'a, 'd>> {
    page.descendants().find(|node| node.attribute("id") == Some(id))
}

fn words(node: Node<'_, '_>) -> String {
    node.descendants().filter(Node::is_text).filter_map(|node| node.text()).collect::<Vec<_>>().join(" ")
}

/// Lists the plan elements missing from a page.
fn missing_elements(page: &str, plan: &Plan) -> Vec<String> {
    let page = match parse(page) {
        Ok(page) => page,
        Err(error) => return vec![error.to_string()],
    };
    let mut missing = Vec::new();
    for (index, pass) in plan.passes.iter().enumerate() {
        let card = with_id(&page, &format!("p{index}"));
        if !card.is_some_and(|card| words(card).contains(&pass.name)) {
            missing.push(format!("pass {}", pass.name));
        }
        let touched =
            card.map_or(0, |card| card.descendants().filter(|n| n.attribute("data-buffer").is_some()).count());
        if touched != pass.accesses.len() {
            missing.push(format!("accesses of {}: {touched}", pass.name));
        }
    }
    for (buffer, info) in plan.buffers() {
        let row = with_id(&page, &format!("b{}", buffer.index()));
        if !row.is_some_and(|row| words(row).contains(&info.name)) {
            missing.push(format!("buffer {}", info.name));
        }
        let number = buffer.index().to_string();
        let drawn = page.descendants().any(|node| {
            node.attribute("class") == Some("box") && node.attribute("data-buffer") == Some(number.as_str())
        });
        if drawn != (plan.placements[buffer.index()].is_some() && info.image.is_none()) {
            missing.push(format!("the place of {}", info.name));
        }
    }
    let barriers = page.descendants().filter(|node| node.attribute("class") == Some("barrier"));
    let expected = plan.groups.iter().filter_map(|group| group.barrier).chain(plan.final_barrier).count();
    if barriers.clone().count() != expected {
        missing.push(format!("barriers: {} of {expected}", barriers.clone().count()));
    }
    for barrier in barriers {
        if !barrier.descendants().any(|node| node.has_tag_name("li")) {
            missing.push(format!("what a barrier is for: {}", words(barrier)));
        }
    }
    let edges = page.descendants().filter(|node| node.attribute("data-from").is_some()).count();
    let expected: usize = plan.dependencies().iter().map(Vec::len).sum();
    if edges != expected {
        missing.push(format!("dependencies: {edges} of {expected}"));
    }
    missing
}

#[test]
fn page_contains_whole_plan() {
    let plan = step().compile(&CompileOptions::default()).unwrap();
    let page = dump::html(&plan, &[]);
    assert_eq!(missing_elements(&page, &plan), [""; 0]);
    // The page loads no external resource.
    for word in ["http:", "https:", "src=", "@import", "url("] {
        assert!(!page.contains(word), "the page contains {word}");
    }
    assert_eq!(page, dump::html(&plan, &[]));
}

#[test]
fn missing_elements_are_detected() {
    let plan = step().compile(&CompileOptions::default()).unwrap();
    let page = dump::html(&plan, &[]);
    for (what, damaged) in [
        ("pass zero_stats", page.replace("<h4>zero_stats</h4>", "<h4></h4>")),
        ("buffer moments", page.replace("<th>moments</th>", "<th></th>")),
        ("the place of image", page.replacen("class=\"box\"", "class=\"\"", 6)),
        ("dependencies", page.replacen("data-from", "data-form", 1)),
        ("barriers", page.replacen("class=\"barrier\"", "class=\"x\"", 1)),
        ("expected 'div' tag", page.replacen("</article>", "", 1)),
    ] {
        assert_ne!(page, damaged, "{what}: nothing was damaged");
        let missing_elements = missing_elements(&damaged, &plan);
        assert!(!missing_elements.is_empty(), "{what} is not detected");
        if !what.starts_with("expected") {
            assert!(missing_elements.iter().any(|l| l.starts_with(what)), "{what}: {missing_elements:?}");
        }
    }
}

#[test]
fn names_are_escaped() {
    let evil = "</script><b title=\"x\" class='y'>&amp; ]]> \u{1}\u{202e}";
    let escaped = evil.replace('\u{1}', "\u{fffd}");
    let mut graph = Graph::new(evil);
    let made = graph.transient(format!("{evil} transient"), 256);
    let out = graph.external(format!("{evil} out"), 256);
    pass(&mut graph, evil, &[(made.slice(0, 256), Write)]);
    pass(&mut graph, "use", &[(made.slice(0, 256), Read), (out.slice(0, 256), ReadWrite)]);
    let plan = graph.compile(&CompileOptions::default()).unwrap();
    let page = dump::html(&plan, &[]);
    let parsed = parse(&page).unwrap();
    assert!(words(with_id(&parsed, "p0").unwrap()).contains(&escaped));
    assert!(words(with_id(&parsed, "b0").unwrap()).contains(&escaped));
    assert_eq!(with_id(&parsed, "p0").unwrap().attribute("data-pass"), Some("0"));
    assert_eq!(page.matches("</script>").count(), 1);
    assert!(!page.contains("<b title"), "a name became markup");
}

#[test]
fn measured_times_are_shown_at_their_passes() {
    let plan = step().compile(&CompileOptions::default()).unwrap();
    let live = plan.groups.iter().flat_map(|group| &group.passes);
    let times: Vec<PassTime> = live
        .enumerate()
        .map(|(at, &pass)| PassTime {
            name: plan.passes[pass].name.clone(),
            start: vec![0.0; 3],
            nanoseconds: vec![1e3 * at as f64, 1e3 * (at + 1) as f64, 1e9],
        })
        .collect();
    let page = dump::html(&plan, &times);
    let parsed = parse(&page).unwrap();
    let last = *plan.groups.last().unwrap().passes.last().unwrap();
    let card = words(with_id(&parsed, &format!("p{last}")).unwrap());
    assert!(card.contains(&format!("{:.1} µs", times.len() as f64)), "{card}");
    assert!(!dump::html(&plan, &[]).contains("µs"));
}

#[test]
fn empty_plans_have_a_page() {
    let mut graph = Graph::new("nothing");
    let plan = graph.clone().compile(&CompileOptions::default()).unwrap();
    assert_eq!(missing_elements(&dump::html(&plan, &[]), &plan), [""; 0]);
    graph.transient("unused", 16);
    let plan = graph.compile(&CompileOptions::default()).unwrap();
    assert_eq!(missing_elements(&dump::html(&plan, &[]), &plan), [""; 0]);
}

#[test]
fn barriers_list_their_hazards() {
    let plan = step().compile(&CompileOptions::default()).unwrap();
    let page = dump::html(&plan, &[]);
    let parsed = parse(&page).unwrap();
    let blend = plan.passes.iter().position(|pass| pass.name == "blend").unwrap();
    let at = plan.groups.iter().position(|group| group.passes.contains(&blend)).unwrap();
    let group = words(with_id(&parsed, &format!("g{at}")).unwrap());
    assert!(group.contains("read after write") && group.contains("arguments") && group.contains("scan"), "{group}");
    let first = words(with_id(&parsed, "g0").unwrap());
    assert!(first.contains("from the previous replay"), "{first}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_plan_has_a_complete_page(recipe in recipes(40)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        let missing_elements = missing_elements(&dump::html(&plan, &[]), &plan);
        prop_assert!(missing_elements.is_empty(), "{:?}\n{}", missing_elements, plan);
    }
}
