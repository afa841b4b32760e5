//! Names of hosts: a list, or one text with commas, as an environment variable has it.

use serde::de::Error;
use serde::{Deserialize, Deserializer};

#[derive(Deserialize)]
#[serde(untagged)]
enum Given {
    List(Vec<String>),
    Text(String),
}

pub(super) fn read<'de, D: Deserializer<'de>>(given: D) -> Result<Vec<String>, D::Error> {
    let names = match Given::deserialize(given) {
        Ok(Given::List(names)) => names,
        Ok(Given::Text(text)) => {
            text.split(',').map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).collect()
        }
        Err(_) => return Err(D::Error::custom("must be a list of names of hosts such as [\"line3.example\"]")),
    };
    match names.iter().find(|name| !is_name(name)) {
        None => Ok(names),
        Some(other) => Err(D::Error::custom(format!(
            "must be names of hosts without scheme, port and path such as line3.example, got \"{other}\""
        ))),
    }
}

fn is_name(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.');
    !name.is_empty() && name.len() <= 253 && !name.ends_with('.') && name.bytes().all(plain)
}

#[cfg(test)]
mod tests {
    use crate::config::Layers;

    fn hosts(value: &str) -> Result<Vec<String>, String> {
        let layers = Layers::default().environment([("COAXIS_HOSTS".into(), value.into())]);
        layers.and_then(Layers::build).map(|config| config.hosts).map_err(|error| error.to_string())
    }

    #[test]
    fn names_are_a_list_or_a_text_with_commas_and_nothing_but_names() {
        assert_eq!(hosts("line3.example").as_deref(), Ok(&["line3.example".to_owned()][..]));
        assert_eq!(hosts("line3, line4").as_deref(), Ok(&["line3".to_owned(), "line4".to_owned()][..]));
        assert_eq!(hosts("[\"line3\"]").as_deref(), Ok(&["line3".to_owned()][..]));
        assert_eq!(hosts("").as_deref(), Ok(&[][..]));
        for wrong in ["http://line3", "line3:8080", "line3/", "*", "line 3"] {
            assert!(hosts(wrong).is_err_and(|error| error.contains("names of hosts")), "{wrong}");
        }
    }
}
