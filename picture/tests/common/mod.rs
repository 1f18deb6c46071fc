//! Reading SVG documents back: one element a line, as this crate writes them.
#![allow(dead_code, reason = "each test file uses its part")]

pub struct Element<'a> {
    pub name: &'a str,
    tag: &'a str,
    text: &'a str,
}

impl<'a> Element<'a> {
    pub fn attribute(&self, name: &str) -> Option<&'a str> {
        let (_, rest) = self.tag.split_once(&format!(" {name}=\""))?;
        rest.split_once('"').map(|(value, _)| value)
    }

    pub fn number(&self, name: &str) -> f64 {
        self.attribute(name).unwrap().parse().unwrap()
    }

    pub fn text(&self) -> String {
        self.text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    }

    /// Points of a path of straight lines.
    pub fn points(&self) -> Vec<[f64; 2]> {
        let pair = |text: &str| {
            let (x, y) = text.split_once(' ').unwrap();
            [x.parse().unwrap(), y.parse().unwrap()]
        };
        let data = self.attribute("d").unwrap().trim_end_matches('Z').strip_prefix('M').unwrap();
        data.split(['M', 'L']).map(pair).collect()
    }
}

/// Elements of a document, the root first; every one is well-formed and closed.
pub fn elements<'a>(svg: &'a str) -> Vec<Element<'a>> {
    let mut lines = svg.lines();
    assert_eq!(lines.next_back(), Some("</svg>"));
    let element = |(i, line): (usize, &'a str)| {
        let (tag, rest) = line.strip_prefix('<').unwrap().split_once('>').unwrap();
        let name = tag.split(' ').next().unwrap();
        let text = match rest.split_once('<') {
            Some((text, end)) => {
                assert_eq!(end, format!("/{name}>"));
                text
            }
            None => {
                assert!(rest.is_empty() && (i == 0 || tag.ends_with('/')), "{line}");
                ""
            }
        };
        assert!(tag.matches('"').count() % 2 == 0 && !text.contains('>'), "{line}");
        Element { name, tag, text }
    };
    lines.enumerate().map(element).collect()
}

pub fn texts(svg: &str) -> Vec<String> {
    elements(svg).iter().filter(|element| element.name == "text").map(Element::text).collect()
}

/// Points of the curves, without grid, axes and legend, which have at most two points or another colour.
pub fn curves(svg: &str, color: [u8; 3]) -> Vec<Vec<[f64; 2]>> {
    let [r, g, b] = color;
    let wanted = format!("#{r:02X}{g:02X}{b:02X}");
    let elements = elements(svg);
    let lines = elements.iter().filter(|e| e.attribute("stroke") == Some(&wanted));
    let lines = lines.filter(|e| e.attribute("stroke-linecap").is_none());
    lines.map(Element::points).filter(|points| points.len() > 2).collect()
}

/// Number of dots.
pub fn dots(svg: &str) -> usize {
    let elements = elements(svg);
    let dots = elements.iter().filter(|element| element.attribute("stroke-linecap") == Some("round"));
    dots.map(|element| element.points().len() / 2).sum()
}

/// Everything lies on the page, texts included as far as their width can be estimated.
pub fn assert_on_page(svg: &str) {
    let elements = elements(svg);
    let view = elements[0].attribute("viewBox").unwrap();
    let view: Vec<f64> = view.split(' ').map(|v| v.parse().unwrap()).collect();
    let inside = |x: f64, y: f64| x >= 0.0 && x <= view[2] && y >= 0.0 && y <= view[3];
    for element in elements {
        if element.name == "path" {
            assert!(element.points().iter().all(|[x, y]| inside(*x, *y)));
        }
        if element.name == "text" {
            let width = 0.5 * element.number("font-size") * element.text().chars().count() as f64;
            let (mut before, mut after) = match element.attribute("text-anchor").unwrap() {
                "start" => (0.0, width),
                "end" => (width, 0.0),
                _ => (0.5 * width, 0.5 * width),
            };
            let (x, y) = (element.number("x"), element.number("y"));
            if element.attribute("transform").is_some() {
                assert!(inside(x, y - after) && inside(x, y + before), "{}", element.text());
                (before, after) = (0.0, 0.0);
            }
            assert!(inside(x - before, y) && inside(x + after, y), "{}", element.text());
        }
    }
}
