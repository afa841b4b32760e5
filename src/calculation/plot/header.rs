//! What stands above every picture: what it shows and of what; when and how that was measured; the result with its
//! uncertainty, or why there is none; and a line about the picture itself.

use super::Subject;
use super::about_axis::names;
use super::notice::{MARGIN, in_lines};
use super::palette::{EXCLUDED, FAINT_INK};
use super::result::{about_uncertainty, result};
use super::svg::{Svg, Type, WIDTH};
use crate::estimation::{Estimate, Method, Outcome};

/// Where the picture may begin below the words, pixels.
pub(super) const BODY_TOP: f64 = 140.0;

const ROOM: f64 = WIDTH - 2.0 * MARGIN;
const LINE: f64 = 16.0;
/// Lines of the result or of the refusal, with what is said about them, and lines about the picture.
const LINES_MAX: usize = 3;
const CAPTION_LINES_MAX: usize = 2;
const SMALL: Type = Type::sized(12.0);
const BETWEEN: &str = " · ";

/// Opens a page with its words.
pub(super) fn page(what: &str, caption: &str, estimate: &Estimate, subject: &Subject<'_>) -> Svg {
    let heading = format!("{what}{BETWEEN}{}", subject.title);
    let (lines, colour) = match &estimate.outcome {
        Outcome::Accepted(pose) => {
            let mut lines = in_lines(SMALL, result(pose).iter().map(String::as_str), BETWEEN, ROOM, LINES_MAX - 1);
            lines.push(about_uncertainty(pose));
            (lines, SMALL.colour)
        }
        Outcome::Refused(refusal) => {
            let words = format!("Refused ({}): {refusal}.", refusal.code());
            (in_lines(SMALL, words.split_whitespace(), " ", ROOM, LINES_MAX), EXCLUDED)
        }
    };
    let caption = match names(estimate).remark {
        Some(remark) => format!("{caption}{BETWEEN}{remark}"),
        None => caption.to_owned(),
    };
    let origin = origin(estimate, subject).join(BETWEEN);
    let mut svg = Svg::new(&heading, &format!("{what}. {origin}. {} {caption}", lines.join(" ")));
    let large = Type::sized(16.0).bold();
    svg.text([MARGIN, 27.0], large, &large.fitted(&heading, ROOM));
    let faint = SMALL.colour(FAINT_INK);
    svg.text([MARGIN, 46.0], faint, &faint.fitted(&origin, ROOM));
    let mut y = 46.0 + LINE;
    for line in &lines {
        svg.text([MARGIN, y], SMALL.colour(colour), &SMALL.fitted(line, ROOM));
        y += LINE;
    }
    for line in in_lines(faint, caption.split(BETWEEN), BETWEEN, ROOM, CAPTION_LINES_MAX) {
        svg.text([MARGIN, y], faint, &faint.fitted(&line, ROOM));
        y += LINE;
    }
    svg
}

/// When and how it was measured, as far as that is known.
fn origin(estimate: &Estimate, subject: &Subject<'_>) -> Vec<String> {
    let mut words = Vec::new();
    words.extend(subject.measured_at.map(|at| format!("measured {}", at.strftime("%Y-%m-%d %H:%M:%S UTC"))));
    words.extend(subject.recipe.map(|recipe| format!("recipe {recipe}")));
    words.push(format!("method {}", estimate.method.name()));
    // `least_squares` gives no verdicts on profiles.
    if !estimate.profiles.is_empty() && estimate.method != Method::LeastSquares {
        let valid_count = estimate.profiles.iter().filter(|profile| profile.rejected.is_none()).count();
        words.push(format!("{valid_count} of {} profiles valid", estimate.profiles.len()));
    }
    words.extend(subject.software.map(str::to_owned));
    words
}
