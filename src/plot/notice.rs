//! The words on a picture: its heading, and paragraphs where there is nothing to draw. Must not know why.

use super::area::Area;
use super::palette::FAINT_INK;
use super::svg::{Svg, Type, WIDTH};

/// Left and right margin of the words, pixels.
pub(super) const MARGIN: f64 = 24.0;

/// A page with its heading: what it shows and of what, and a line of numbers below.
pub(super) fn page(what: &str, subject: &str, caption: &str) -> Svg {
    let heading = format!("{what} · {subject}");
    let mut svg = Svg::new(&heading, &format!("{what}. {caption}"));
    let (large, small) = (Type::sized(16.0).bold(), Type::sized(12.0).colour(FAINT_INK));
    let room = WIDTH - 2.0 * MARGIN;
    svg.text([MARGIN, 29.0], large, &large.fitted(&heading, room));
    svg.text([MARGIN, 50.0], small, &small.fitted(caption, room));
    svg
}

/// Writes `text` into `area` in as many lines as it takes; returns where they end.
pub(super) fn paragraph(svg: &mut Svg, area: Area, look: Type, text: &str) -> f64 {
    let mut y = area.top + look.size;
    for line in wrapped(look, text, area.width) {
        svg.text([area.left, y], look, &line);
        y += 1.45 * look.size;
    }
    y
}

fn wrapped(look: Type, text: &str, width: f64) -> Vec<String> {
    let mut lines = Vec::new();
    let mut line = String::new();
    for word in text.split_whitespace() {
        let longer = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
        if look.width_of(&longer) <= width || line.is_empty() {
            line = longer;
        } else {
            lines.push(std::mem::replace(&mut line, word.to_owned()));
        }
    }
    lines.push(line);
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_wrapped_between_words_and_none_is_lost() {
        let look = Type::sized(12.0);
        let text = "only 2 of 120 profiles are valid, 3 are needed; see the profiles for each reason";
        let lines = wrapped(look, text, 200.0);
        assert!(lines.len() > 2 && lines.iter().all(|line| look.width_of(line) <= 200.0));
        assert_eq!(lines.join(" "), text);
    }
}
