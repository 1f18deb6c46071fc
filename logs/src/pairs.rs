//! Lines of names and values, as scripts print dictionaries and as JSON has them, one object in a line.

use super::cells::number;
use super::long_form::Wide;
use super::table::Table;
use super::times::is_time_name;

/// Lines from which the form is inferred.
const SAMPLE: usize = 50;
const LEAST_PAIRS: usize = 2;

/// One line: names with their values, and the first number before them.
struct Line<'a> {
    pairs: Vec<(&'a str, &'a str)>,
    before: Option<&'a str>,
}

/// The table of such lines; `None` if they are fewer than half of a text.
pub(super) fn table(file: &str, text: &str) -> Option<Table> {
    let lines = || text.lines().zip(1_u64..).filter(|(line, _)| !line.trim().is_empty());
    let (mut sampled, mut found) = (0, 0);
    for (line, _) in lines().take(SAMPLE) {
        sampled += 1;
        found += usize::from(Line::parse(line).is_some());
    }
    if 2 * found <= sampled {
        return None;
    }
    let mut wide = Wide::default();
    for (line, number) in lines() {
        let Some(parsed) = Line::parse(line) else { continue };
        let named = parsed.pairs.iter().find(|(name, _)| is_time_name(name)).map(|(_, value)| *value);
        let Some(time) = named.or(parsed.before) else { continue };
        for (name, value) in parsed.pairs.iter().filter(|(name, _)| !is_time_name(name)) {
            wide.add_value(number, time.as_bytes(), name, value.as_bytes());
        }
    }
    Some(wide.into_table(file))
}

impl<'a> Line<'a> {
    fn parse(line: &'a str) -> Option<Self> {
        let from = line.find('{')?;
        let inner = &line[from + 1..line.rfind('}').filter(|to| *to > from)?];
        let pairs: Vec<(&str, &str)> = inner.split(',').filter_map(pair).collect();
        let is_digit = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-');
        let mut words = line[..from].split(|c| !is_digit(c));
        let before = words.find(|word| number(word.as_bytes()).is_some());
        (pairs.len() >= LEAST_PAIRS).then_some(Self { pairs, before })
    }
}

/// A name and its value, without quotes.
fn pair(text: &str) -> Option<(&str, &str)> {
    let (name, value) = text.rsplit_once(':')?;
    let [name, value] = [name, value].map(|word| word.trim().trim_matches(['\'', '"']));
    (!name.is_empty() && number(value.as_bytes()).is_some()).then_some((name, value))
}
