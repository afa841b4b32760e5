//! Writes SVG. Numbers have a fixed form, so equal pictures are equal bytes; text is escaped; a coordinate that is not a number
//! cannot get into the file. Areas of the page are in pixels; y grows downwards.

use super::palette::INK;
use std::fmt::{self, Display, Write as _};

/// Width of every picture, pixels.
pub(super) const WIDTH: f64 = 1000.0;
/// Height of every picture, pixels.
pub(super) const HEIGHT: f64 = 700.0;

/// A coordinate on the page: tenths of a pixel, without a trailing zero.
pub(super) struct Px(pub(super) f64);

impl Display for Px {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Positions far outside the page are equivalent; a NaN is a programming error that must not break the document.
        let value = if self.0.is_finite() { self.0.clamp(-1e6, 1e6) } else { 0.0 };
        let tenths = (value * 10.0).round() as i64;
        let sign = if tenths < 0 { "-" } else { "" };
        match (tenths.abs() / 10, tenths.abs() % 10) {
            (whole, 0) => write!(f, "{sign}{whole}"),
            (whole, tenth) => write!(f, "{sign}{whole}.{tenth}"),
        }
    }
}

/// Position of the anchor in a text.
#[derive(Debug, Clone, Copy)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// Style of a text.
#[derive(Debug, Clone, Copy)]
pub(super) struct Type {
    pub(super) size: f64,
    pub(super) anchor: Anchor,
    pub(super) colour: &'static str,
    pub(super) bold: bool,
    /// Rotated to read upwards.
    pub(super) turned: bool,
}

impl Type {
    /// Normal text with its anchor at its start.
    pub(super) const fn sized(size: f64) -> Self {
        Self { size, anchor: Anchor::Start, colour: INK, bold: false, turned: false }
    }

    pub(super) const fn anchor(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }

    pub(super) const fn colour(self, colour: &'static str) -> Self {
        Self { colour, ..self }
    }

    pub(super) const fn bold(self) -> Self {
        Self { bold: true, ..self }
    }

    pub(super) const fn turned(self) -> Self {
        Self { turned: true, ..self }
    }

    /// Approximate width of a text, pixels: the font is unknown here, so this is an upper estimate.
    pub(super) fn width_of(&self, text: &str) -> f64 {
        let ems: f64 = text.chars().map(|c| if c as u32 >= 0x2E80 { 1.0 } else { 0.54 }).sum();
        ems * self.size * if self.bold { 1.08 } else { 1.0 }
    }

    /// `text`, cut with an ellipsis if it would be wider than `width`.
    pub(super) fn fitted(&self, text: &str, width: f64) -> String {
        if self.width_of(text) <= width {
            return text.to_owned();
        }
        let mut kept = String::new();
        for c in text.chars() {
            kept.push(c);
            if self.width_of(&kept) > width - self.size {
                break;
            }
        }
        kept.push('…');
        kept
    }
}

/// A document being written.
pub(super) struct Svg(String);

impl Svg {
    /// Opens a white page. `title` and `description` are for screen readers.
    pub(super) fn new(title: &str, description: &str) -> Self {
        let mut svg = Self(String::with_capacity(16 * 1024));
        svg.put(format_args!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" version=\"1.1\" width=\"{WIDTH}\" height=\"{HEIGHT}\" \
             viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" font-family=\"DejaVu Sans, Verdana, Arial, sans-serif\">\n\
             <title>{}</title>\n<desc>{}</desc>",
            Escaped(title),
            Escaped(description)
        ));
        svg.rect(Area::new(0.0, 0.0, WIDTH, HEIGHT), "fill=\"#ffffff\"");
        svg
    }

    /// Closes the page.
    pub(super) fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }

    fn put(&mut self, line: fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _ = self.0.write_fmt(line);
        self.0.push('\n');
    }

    pub(super) fn rect(&mut self, area: Area, paint: impl Display) {
        let Area { left, top, width, height } = area;
        let (x, y, w, h) = (Px(left), Px(top), Px(width), Px(height));
        self.put(format_args!("<rect x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" {paint}/>"));
    }

    pub(super) fn line(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], paint: impl Display) {
        let (x1, y1, x2, y2) = (Px(x1), Px(y1), Px(x2), Px(y2));
        self.put(format_args!("<line x1=\"{x1}\" y1=\"{y1}\" x2=\"{x2}\" y2=\"{y2}\" {paint}/>"));
    }

    /// A path of path data; nothing for empty data.
    pub(super) fn path(&mut self, data: &str, paint: impl Display) {
        if !data.is_empty() {
            self.put(format_args!("<path d=\"{data}\" {paint}/>"));
        }
    }

    pub(super) fn text(&mut self, [x, y]: [f64; 2], look: Type, text: &str) {
        let anchor = match look.anchor {
            Anchor::Start => "",
            Anchor::Middle => " text-anchor=\"middle\"",
            Anchor::End => " text-anchor=\"end\"",
        };
        let weight = if look.bold { " font-weight=\"bold\"" } else { "" };
        let (size, colour, text, x, y) = (Px(look.size), look.colour, Escaped(text), Px(x), Px(y));
        let place = if look.turned {
            format!("transform=\"translate({x} {y}) rotate(-90)\"")
        } else {
            format!("x=\"{x}\" y=\"{y}\"")
        };
        self.put(format_args!("<text {place} font-size=\"{size}\" fill=\"{colour}\"{anchor}{weight}>{text}</text>"));
    }

    /// Clips the output of `draw` to `area`. `id` must be unique on the page.
    pub(super) fn clipped(&mut self, id: &str, area: Area, draw: impl FnOnce(&mut Self)) {
        self.put(format_args!("<clipPath id=\"{id}\">"));
        self.rect(area, "");
        self.put(format_args!("</clipPath>\n<g clip-path=\"url(#{id})\">"));
        draw(self);
        self.put(format_args!("</g>"));
    }

    /// Scales the output of `draw` to cells of `cell` pixels from the corner of `area`.
    pub(super) fn gridded(&mut self, area: Area, cell: [f64; 2], draw: impl FnOnce(&mut Self)) {
        let [width, height] = cell;
        let (left, top) = (Px(area.left), Px(area.top));
        self.put(format_args!(
            "<g transform=\"translate({left} {top}) scale({width:.5} {height:.5})\" shape-rendering=\"crispEdges\">"
        ));
        draw(self);
        self.put(format_args!("</g>"));
    }
}

/// Text that may appear between tags: markup is escaped, and characters that XML forbids are shown as a question mark.
struct Escaped<'a>(&'a str);

impl Display for Escaped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for c in self.0.chars() {
            match c {
                '&' => f.write_str("&amp;")?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '"' => f.write_str("&quot;")?,
                '\t' | '\n' | '\r' => f.write_char(' ')?,
                c if c.is_control() || matches!(c, '\u{FFFE}' | '\u{FFFF}') => f.write_char('?')?,
                c => f.write_char(c)?,
            }
        }
        Ok(())
    }
}

/// A rectangle of the page, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Area {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) width: f64,
    pub(super) height: f64,
}

impl Area {
    pub(super) const fn new(left: f64, top: f64, width: f64, height: f64) -> Self {
        Self { left, top, width, height }
    }

    pub(super) fn right(&self) -> f64 {
        self.left + self.width
    }

    pub(super) fn bottom(&self) -> f64 {
        self.top + self.height
    }

    pub(super) fn middle(&self) -> [f64; 2] {
        [self.left + self.width / 2.0, self.top + self.height / 2.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_have_one_form_and_are_always_numbers() {
        let written = [12.0, 12.34, -0.04, -3.26, 1e300, f64::NAN, f64::INFINITY].map(|v| Px(v).to_string());
        assert_eq!(written, ["12", "12.3", "0", "-3.3", "1000000", "0", "0"]);
    }

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(Escaped("a<b>&\"c\u{1}\nd").to_string(), "a&lt;b&gt;&amp;&quot;c? d");
    }

    #[test]
    fn long_text_is_cut_to_its_width() {
        let look = Type::sized(10.0);
        assert_eq!(look.fitted("short", 100.0), "short");
        let cut = look.fitted(&"long ".repeat(100), 100.0);
        assert!(cut.ends_with('…') && look.width_of(&cut) <= 105.0, "{cut}");
    }
}
