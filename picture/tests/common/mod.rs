//! Reading SVG documents back.
#![allow(dead_code, reason = "each test file uses its part")]

use roxmltree::{Document, Node};

pub fn texts(document: &Document) -> Vec<String> {
    let nodes = document.descendants().filter(|node| node.has_tag_name("text"));
    nodes.filter_map(|node| node.text()).map(|text| text.trim().to_owned()).collect()
}

/// Points of the curves, without grid, axes and legend, which have at most two points or another colour.
pub fn curves(document: &Document, color: [u8; 3]) -> Vec<Vec<(f64, f64)>> {
    let [r, g, b] = color;
    let wanted = format!("#{r:02X}{g:02X}{b:02X}");
    let lines = document
        .descendants()
        .filter(|n| n.has_tag_name("polyline") && n.attribute("stroke") == Some(&wanted));
    lines.map(points).filter(|points| points.len() > 2).collect()
}

fn points(node: Node) -> Vec<(f64, f64)> {
    let pair = |text: &str| {
        let (x, y) = text.split_once(',').unwrap();
        (x.parse().unwrap(), y.parse().unwrap())
    };
    node.attribute("points").unwrap().split_whitespace().map(pair).collect()
}

/// Everything lies on the page, texts included as far as their width can be estimated.
pub fn assert_on_page(document: &Document) {
    let root = document.root_element();
    let view: Vec<f64> = root.attribute("viewBox").unwrap().split(' ').map(|v| v.parse().unwrap()).collect();
    let inside = |x: f64, y: f64| x >= 0.0 && x <= view[2] && y >= 0.0 && y <= view[3];
    for node in document.descendants() {
        if node.attribute("points").is_some() {
            assert!(points(node).iter().all(|(x, y)| inside(*x, *y)));
        }
        if node.has_tag_name("text") {
            let value = |name: &str| node.attribute(name).unwrap().parse::<f64>().unwrap();
            let width = 0.55 * value("font-size") * node.text().unwrap().trim().chars().count() as f64;
            let (mut before, mut after) = match node.attribute("text-anchor").unwrap() {
                "start" => (0.0, width),
                "end" => (width, 0.0),
                _ => (0.5 * width, 0.5 * width),
            };
            let (x, y) = (value("x"), value("y"));
            if node.attribute("transform").is_some() {
                assert!(inside(x, y - after) && inside(x, y + before), "{node:?}");
                (before, after) = (0.0, 0.0);
            }
            assert!(inside(x - before, y) && inside(x + after, y), "{:?}", node.text());
        }
    }
}
