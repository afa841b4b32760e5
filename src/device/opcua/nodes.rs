//! Values of nodes, taken apart: a type, a length, a quality at a time. Everything that comes from a server passes here and is
//! hostile until it has.

use super::layout::Node;
use opcua::types::{DataValue, Range, StatusCode, Variant};

/// Why a value is none.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum Odd {
    /// The answer is shorter than the question.
    #[error("{} is missing in the answer", .0.key())]
    Missing(Node),
    /// The server does not stand by it.
    #[error("{} has the quality {quality}", node.key())]
    Quality {
        /// Which.
        node: Node,
        /// As the server gives it.
        quality: StatusCode,
    },
    /// Another type, or another length.
    #[error("{} is not {wanted}", node.key())]
    Type {
        /// Which.
        node: Node,
        /// In words.
        wanted: &'static str,
    },
    /// Of the right type, and impossible.
    #[error("{} is {value}, which {why}", node.key())]
    Value {
        /// Which.
        node: Node,
        /// As read.
        value: String,
        /// What is wrong with it.
        why: &'static str,
    },
}

/// A server's answer, each value with its node.
pub(super) struct Answer<'a> {
    values: &'a [(Node, DataValue)],
}

impl<'a> Answer<'a> {
    pub(super) const fn new(values: &'a [(Node, DataValue)]) -> Self {
        Self { values }
    }

    /// The first value of a node, whatever its quality.
    pub(super) fn raw(&self, node: Node) -> Result<&'a DataValue, Odd> {
        self.values.iter().find(|(of, _)| *of == node).map(|(_, value)| value).ok_or(Odd::Missing(node))
    }

    fn good(&self, node: Node) -> Result<&'a Variant, Odd> {
        variant(node, self.raw(node)?)
    }

    /// A count that fits 16 bits, of whatever integer type.
    pub(super) fn word(&self, node: Node) -> Result<u16, Odd> {
        let wanted = "a whole number of 16 bits";
        whole(self.good(node)?).and_then(|value| value.try_into().ok()).ok_or(Odd::Type { node, wanted })
    }

    /// A count that fits 32 bits, of whatever integer type.
    pub(super) fn double_word(&self, node: Node) -> Result<u32, Odd> {
        let wanted = "a whole number of 32 bits";
        whole(self.good(node)?).and_then(|value| value.try_into().ok()).ok_or(Odd::Type { node, wanted })
    }

    /// A count that fits 64 bits and is not negative, of whatever integer type.
    pub(super) fn long(&self, node: Node) -> Result<u64, Odd> {
        let wanted = Odd::Type { node, wanted: "a whole number of 64 bits" };
        match self.good(node)? {
            Variant::UInt64(value) => Ok(*value),
            other => whole(other).and_then(|value| value.try_into().ok()).ok_or(wanted),
        }
    }

    /// A finite number.
    pub(super) fn number(&self, node: Node) -> Result<f64, Odd> {
        let value = number(self.good(node)?).ok_or(Odd::Type { node, wanted: "a number" })?;
        finite(node, value)
    }

    /// Four finite numbers.
    pub(super) fn numbers(&self, node: Node) -> Result<[f64; 4], Odd> {
        let [x, y, z, c] = self.four(node, "four numbers", number)?;
        Ok([finite(node, x)?, finite(node, y)?, finite(node, z)?, finite(node, c)?])
    }

    /// Four counts of 16 bits.
    pub(super) fn words(&self, node: Node) -> Result<[u16; 4], Odd> {
        self.four(node, "four whole numbers of 16 bits", |value| whole(value)?.try_into().ok())
    }

    /// Four truths.
    pub(super) fn truths(&self, node: Node) -> Result<[bool; 4], Odd> {
        self.four(node, "four truth values", |value| match value {
            Variant::Boolean(truth) => Some(*truth),
            _ => None,
        })
    }

    /// A range, its ends finite and in order.
    pub(super) fn range(&self, node: Node) -> Result<(f64, f64), Odd> {
        let wrong = Odd::Type { node, wanted: "a range" };
        let Variant::ExtensionObject(object) = self.good(node)? else { return Err(wrong) };
        let range = object.inner_as::<Range>().ok_or(wrong)?;
        let (low, high) = (finite(node, range.low)?, finite(node, range.high)?);
        if low < high {
            Ok((low, high))
        } else {
            Err(Odd::Value { node, value: format!("{low} to {high}"), why: "is no range" })
        }
    }

    fn four<T>(&self, node: Node, wanted: &'static str, take: impl Fn(&Variant) -> Option<T>) -> Result<[T; 4], Odd> {
        let wrong = || Odd::Type { node, wanted };
        let Variant::Array(array) = self.good(node)? else { return Err(wrong()) };
        let taken: Option<Vec<T>> = array.values.iter().take(5).map(take).collect();
        taken.and_then(|taken| taken.try_into().ok()).ok_or_else(wrong)
    }
}

/// A value that the server stands by. Good with a reservation, such as "overridden" or "clamped", is not good.
pub(super) fn variant(node: Node, value: &DataValue) -> Result<&Variant, Odd> {
    let quality = value.status.unwrap_or(StatusCode::Good);
    if quality != StatusCode::Good {
        return Err(Odd::Quality { node, quality });
    }
    value.value.as_ref().ok_or(Odd::Type { node, wanted: "there" })
}

fn whole(value: &Variant) -> Option<i64> {
    match *value {
        Variant::SByte(value) => Some(value.into()),
        Variant::Byte(value) => Some(value.into()),
        Variant::Int16(value) => Some(value.into()),
        Variant::UInt16(value) => Some(value.into()),
        Variant::Int32(value) => Some(value.into()),
        Variant::UInt32(value) => Some(value.into()),
        Variant::Int64(value) => Some(value),
        Variant::UInt64(value) => value.try_into().ok(),
        _ => None,
    }
}

fn number(value: &Variant) -> Option<f64> {
    match *value {
        Variant::Double(value) => Some(value),
        Variant::Float(value) => Some(value.into()),
        _ => None,
    }
}

fn finite(node: Node, value: f64) -> Result<f64, Odd> {
    if value.is_finite() { Ok(value) } else { Err(Odd::Value { node, value: value.to_string(), why: "is not finite" }) }
}
