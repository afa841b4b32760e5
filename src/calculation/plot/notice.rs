//! Text that is wrapped into lines.

use super::area::Area;
use super::svg::{Svg, Type};

/// Left and right margin of the words, pixels.
pub(super) const MARGIN: f64 = 24.0;

/// Writes `text` into `area` in as many lines as it takes; returns where they end.
pub(super) fn paragraph(svg: &mut Svg, area: Area, look: Type, text: &str) -> f64 {
    let mut y = area.top + look.size;
    for line in in_lines(look, text.split_whitespace(), " ", area.width, usize::MAX) {
        svg.text([area.left, y], look, &line);
        y += 1.45 * look.size;
    }
    y
}

/// Pieces of text in lines of this width; what does not fit into `most` lines is left out, with an ellipsis.
pub(super) fn in_lines<'a>(
    look: Type,
    pieces: impl Iterator<Item = &'a str>,
    between: &str,
    width: f64,
    most: usize,
) -> Vec<String> {
    let mut lines = Vec::new();
    let mut line = String::new();
    for piece in pieces {
        let longer = if line.is_empty() { piece.to_owned() } else { format!("{line}{between}{piece}") };
        if look.width_of(&longer) <= width || line.is_empty() {
            line = longer;
        } else {
            lines.push(std::mem::replace(&mut line, piece.to_owned()));
        }
    }
    lines.push(line);
    if lines.len() > most {
        lines.truncate(most);
        if let Some(last) = lines.last_mut() {
            last.push_str(" …");
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_wrapped_between_words_and_none_is_lost() {
        let look = Type::sized(12.0);
        let text = "only 2 of 120 profiles are valid, 3 are needed; see the profiles for each reason";
        let lines = |most| in_lines(look, text.split_whitespace(), " ", 200.0, most);
        let all = lines(usize::MAX);
        assert!(all.len() > 2 && all.iter().all(|line| look.width_of(line) <= 200.0));
        assert_eq!(all.join(" "), text);
        assert_eq!(lines(1), [format!("{} …", all[0])]);
    }
}
