//! Translates messages of the JSON parser (variants, sequences, f64) into words for users, and formats numbers in messages.

/// The UTF-8 byte order mark that some programs write.
const MARK: &[u8] = b"\xef\xbb\xbf";

/// A document without its byte order mark, if it has one.
#[must_use]
pub fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(MARK).unwrap_or(bytes)
}

/// A message of the deserializer in words for users.
#[must_use]
pub fn in_words(message: &str) -> String {
    let (reason, place) = match message.rsplit_once(" at line ") {
        Some((reason, place)) => (reason, format!(" (line {})", place.replace(" column", ", column"))),
        None => (message, String::new()),
    };
    // The reason may follow a path.
    let starts = ["unknown variant ", "unknown field ", "missing field ", "duplicate field ", "invalid "];
    let at = starts.iter().filter_map(|start| reason.find(start)).min();
    let (path, reason) = reason.split_at(at.unwrap_or(0));
    format!("{path}{}{place}", reason_in_words(reason))
}

fn reason_in_words(reason: &str) -> String {
    let found_and_expected = |rest: &str| {
        let (found, expected) = rest.rsplit_once(", expected ").unwrap_or((rest, ""));
        (found_in_words(found), expected_in_words(expected))
    };
    if let Some(rest) = reason.strip_prefix("unknown variant ") {
        let (found, names) = quoted_and_rest(rest);
        format!("there is no {found:?} here; there is {}", names_of(names))
    } else if let Some(rest) = reason.strip_prefix("unknown field ") {
        let (found, names) = quoted_and_rest(rest);
        match names.contains('`') {
            true => format!("there is no {found}; there is {}", names_of(names)),
            false => format!("there is no {found}; no parameter is accepted here"),
        }
    } else if let Some(rest) = reason.strip_prefix("missing field ") {
        format!("{} is missing", rest.trim_matches('`'))
    } else if let Some(rest) = reason.strip_prefix("duplicate field ") {
        format!("{} is given twice", rest.trim_matches('`'))
    } else if let Some(rest) = reason.strip_prefix("invalid type: ").or_else(|| reason.strip_prefix("invalid value: "))
    {
        let (found, expected) = found_and_expected(rest);
        format!("{found} is given where {expected} is needed")
    } else if let Some(rest) = reason.strip_prefix("invalid length ") {
        let (found, expected) = found_and_expected(rest);
        format!("{found} entries are given where {expected} is needed")
    } else {
        number_in_words(reason)
    }
}

/// The message for a number in a query, or for a document that is not JSON.
fn number_in_words(reason: &str) -> String {
    const SAID: [(&str, &str); 13] = [
        ("invalid digit found in string", "that is not a whole number of 0 or more"),
        ("invalid float literal", "that is not a number"),
        ("cannot parse float from empty string", "a number is missing"),
        ("cannot parse integer from empty string", "a number is missing"),
        ("number too large to fit in target type", "the number is too large"),
        ("number too small to fit in target type", "the number is too small"),
        ("provided string was not `true` or `false`", "that is neither true nor false"),
        ("expected value", "another value is needed"),
        ("expected ident", "there is a word that is not JSON"),
        ("expected `,` or `}`", "a comma or } is needed"),
        ("expected `,` or `]`", "a comma or ] is needed"),
        ("expected `:`", "a colon is needed"),
        ("EOF while parsing", "the document ends within"),
    ];
    SAID.into_iter().fold(reason.to_owned(), |text, (from, to)| text.replace(from, to))
}

/// The first word in backticks, and the text after it.
fn quoted_and_rest(text: &str) -> (&str, &str) {
    let inside = text.strip_prefix('`').unwrap_or(text);
    inside.split_once('`').unwrap_or((inside, ""))
}

/// The words in backticks, separated by commas.
fn names_of(text: &str) -> String {
    text.split('`').skip(1).step_by(2).collect::<Vec<_>>().join(", ")
}

fn found_in_words(found: &str) -> String {
    const KINDS: [(&str, &str); 5] = [
        ("string ", "the text "),
        ("integer ", "the number "),
        ("floating point ", "the number "),
        ("boolean ", "the word "),
        ("character ", "the text "),
    ];
    const WHOLE: [(&str, &str); 6] = [
        ("null", "null"),
        ("sequence", "a list"),
        ("map", "an object"),
        ("unit value", "null"),
        ("Option value", "null"),
        ("newtype struct", "an object"),
    ];
    let of_kind = KINDS.into_iter().find_map(|(kind, word)| Some(format!("{word}{}", found.strip_prefix(kind)?)));
    let whole = || WHOLE.into_iter().find(|(kind, _)| *kind == found).map(|(_, word)| word.to_owned());
    of_kind.or_else(whole).unwrap_or_else(|| found.to_owned()).replace('`', "")
}

fn expected_in_words(expected: &str) -> String {
    if let Some(count) =
        expected.strip_prefix("an array of length ").or_else(|| expected.strip_prefix("a tuple of size "))
    {
        return format!("a list of {count}");
    }
    let is_one_of = |words: &[&str]| words.contains(&expected);
    if is_one_of(&["f64", "f32", "a number"]) {
        "a number"
    } else if is_one_of(&["u8", "u16", "u32", "u64", "usize"]) {
        "a whole number of 0 or more"
    } else if is_one_of(&["i8", "i16", "i32", "i64", "isize"]) {
        "a whole number"
    } else if is_one_of(&["a string", "a borrowed string", "str", "string", "identifier", "a string key"]) {
        "a text"
    } else if is_one_of(&["a boolean", "bool"]) {
        "true or false"
    } else if expected.contains("sequence") || expected.starts_with("tuple") {
        "a list"
    } else if expected.contains("enum") || expected.contains("variant") {
        "one of its names"
    } else if expected.contains("struct") || expected.contains("map") || expected == "unit" {
        "an object"
    } else {
        return expected.replace('`', "");
    }
    .to_owned()
}

/// A number for people: seven digits, and an exponent instead of a row of zeros.
#[must_use]
pub fn plain(value: f64) -> String {
    let short = format!("{value:.6e}").parse().unwrap_or(value);
    match value.abs() {
        0.0 => "0".to_owned(),
        size if (1e-4..1e7).contains(&size) => format!("{short}"),
        _ => format!("{short:e}"),
    }
}

#[cfg(test)]
mod in_words_tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Way {
        There,
        Back,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "read only")]
    struct Thing {
        way: Way,
        length_mm: f64,
        count: Option<u32>,
        at: Option<[f64; 3]>,
        name: Option<String>,
        is_open: Option<bool>,
        list: Option<Vec<f64>>,
        inner: Option<Box<Thing>>,
    }

    #[test]
    fn no_term_of_the_deserializer_remains() {
        for (text, words) in [
            (r#"{"way": "up", "length_mm": 1}"#, "there is no \"up\" here; there is there, back (line 1, column 12)"),
            (r#"{"way": "back"}"#, "length_mm is missing"),
            (r#"{"way": "back", "way": "back"}"#, "way is given twice"),
            (r#"{"away": 1}"#, "there is no away; there is way, length_mm, count"),
            (r#"{"length_mm": "1,5"}"#, "the text \"1,5\" is given where a number is needed"),
            (r#"{"count": -1}"#, "the number -1 is given where a whole number of 0 or more is needed"),
            (r#"{"count": 1.5}"#, "the number 1.5 is given where a whole number of 0 or more is needed"),
            (r#"{"at": [1, 2]}"#, "2 entries are given where a list of 3 is needed"),
            (r#"{"at": {}}"#, "an object is given where a list of 3 is needed"),
            (r#"{"name": 5}"#, "the number 5 is given where a text is needed"),
            (r#"{"is_open": "yes"}"#, "the text \"yes\" is given where true or false is needed"),
            (r#"{"list": 5}"#, "the number 5 is given where a list is needed"),
            (r#"{"inner": 5}"#, "the number 5 is given where an object is needed"),
            (r#"{"way": 5}"#, "needed"),
            (r#"{"length_mm": null}"#, "null is given where a number is needed"),
        ] {
            let error = serde_json::from_str::<Thing>(text).expect_err("wrong").to_string();
            let said = in_words(&error);
            assert!(said.contains(words), "{error} -> {said}");
            for word in ["variant", "f64", "u32", "struct", "sequence", "expected", "field", "`", "enum"] {
                assert!(!said.contains(word), "{error} -> {said}");
            }
        }
        for text in ["{", "{\"a\" 1}", "[1 2]", "{\"a\": 1 2}", "{\"a\": nul}", "{\"a\": NaN}"] {
            let error = serde_json::from_str::<serde_json::Value>(text).expect_err("no JSON").to_string();
            let said = in_words(&error);
            assert!(!said.contains("expected") && !said.contains('`') && !said.contains("EOF"), "{error} -> {said}");
        }
        assert_eq!(in_words("limit: invalid digit found in string"), "limit: that is not a whole number of 0 or more");
        assert_eq!(in_words("no order was named"), "no order was named");
    }

    #[test]
    fn a_byte_order_mark_is_removed() {
        assert_eq!(without_mark("\u{feff}{}".as_bytes()), b"{}");
        assert_eq!(without_mark(b"{}"), b"{}");
    }
}

#[cfg(test)]
mod plain_tests {
    use super::*;

    #[test]
    fn every_number_in_a_message_is_short() {
        for (value, text) in [
            (0.0, "0"),
            (-0.5, "-0.5"),
            (30.000000000000004, "30"),
            (123_456.0, "123456"),
            (1e300, "1e300"),
            (f64::MIN_POSITIVE, "2.225074e-308"),
            (-1.0 / 3.0, "-0.3333333"),
        ] {
            assert_eq!(plain(value), text);
        }
    }
}
