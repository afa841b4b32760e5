//! Checks the values of nodes: type, length and quality. Every value from a server is checked here before it is used.
//!
//! Once, on connecting, it also checks whether the positions have the expected units, and whether commands can be written as this
//! adaptor writes them, because the server must not accept one half of a command and refuse the other. Pure.

use opcua::types::{AttributeId, DataTypeId, DataValue, EUInformation, NodeId, Range, StatusCode, Variant};

use crate::motion::Axis;

use super::layout::Node;

/// Why a value is not usable.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum UnexpectedValue {
    /// The answer has fewer values than requested.
    #[error("{} is missing in the answer", .0.key())]
    Missing(Node),
    /// The server does not report good quality.
    #[error("{} has the quality {quality}", node.key())]
    Quality {
        /// The node.
        node: Node,
        /// The quality that the server reports.
        quality: StatusCode,
    },
    /// The value has another type or length.
    #[error("{} is not {wanted}", node.key())]
    Type {
        /// The node.
        node: Node,
        /// The expected type, as text.
        wanted: &'static str,
    },
    /// The value has the right type but is not possible.
    #[error("{} is {value}, which {why}", node.key())]
    Value {
        /// The node.
        node: Node,
        /// The value that was read.
        value: String,
        /// Why it is not possible.
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

    /// The first value of a node, of any quality.
    pub(super) fn raw(&self, node: Node) -> Result<&'a DataValue, UnexpectedValue> {
        self.values.iter().find(|(of, _)| *of == node).map(|(_, value)| value).ok_or(UnexpectedValue::Missing(node))
    }

    fn good(&self, node: Node) -> Result<&'a Variant, UnexpectedValue> {
        variant(node, self.raw(node)?)
    }

    /// A count that fits into 16 bits, of any integer type.
    pub(super) fn word(&self, node: Node) -> Result<u16, UnexpectedValue> {
        let wanted = "a whole number of 16 bits";
        whole(self.good(node)?).and_then(|value| value.try_into().ok()).ok_or(UnexpectedValue::Type { node, wanted })
    }

    /// A count that fits into 32 bits, of any integer type.
    pub(super) fn double_word(&self, node: Node) -> Result<u32, UnexpectedValue> {
        let wanted = "a whole number of 32 bits";
        whole(self.good(node)?).and_then(|value| value.try_into().ok()).ok_or(UnexpectedValue::Type { node, wanted })
    }

    /// A non-negative count that fits into 64 bits, of any integer type.
    pub(super) fn long(&self, node: Node) -> Result<u64, UnexpectedValue> {
        let wanted = UnexpectedValue::Type { node, wanted: "a whole number of 64 bits" };
        match self.good(node)? {
            Variant::UInt64(value) => Ok(*value),
            other => whole(other).and_then(|value| value.try_into().ok()).ok_or(wanted),
        }
    }

    /// A finite number.
    pub(super) fn number(&self, node: Node) -> Result<f64, UnexpectedValue> {
        let value = number(self.good(node)?).ok_or(UnexpectedValue::Type { node, wanted: "a number" })?;
        finite(node, value)
    }

    /// Four finite numbers.
    pub(super) fn numbers(&self, node: Node) -> Result<[f64; 4], UnexpectedValue> {
        let [x, y, z, c] = self.four(node, "four numbers", number)?;
        Ok([finite(node, x)?, finite(node, y)?, finite(node, z)?, finite(node, c)?])
    }

    /// Four counts of 16 bits.
    pub(super) fn words(&self, node: Node) -> Result<[u16; 4], UnexpectedValue> {
        self.four(node, "four whole numbers of 16 bits", |value| whole(value)?.try_into().ok())
    }

    /// Four Booleans.
    pub(super) fn truths(&self, node: Node) -> Result<[bool; 4], UnexpectedValue> {
        self.four(node, "four truth values", |value| match value {
            Variant::Boolean(truth) => Some(*truth),
            _ => None,
        })
    }

    /// A range whose ends are finite and in order.
    pub(super) fn range(&self, node: Node) -> Result<(f64, f64), UnexpectedValue> {
        let wrong = UnexpectedValue::Type { node, wanted: "a range" };
        let Variant::ExtensionObject(object) = self.good(node)? else { return Err(wrong) };
        let range = object.inner_as::<Range>().ok_or(wrong)?;
        let (low, high) = (finite(node, range.low)?, finite(node, range.high)?);
        if low < high {
            Ok((low, high))
        } else {
            Err(UnexpectedValue::Value { node, value: format!("{low} to {high}"), why: "is no range" })
        }
    }

    fn four<T>(
        &self,
        node: Node,
        wanted: &'static str,
        take: impl Fn(&Variant) -> Option<T>,
    ) -> Result<[T; 4], UnexpectedValue> {
        let wrong = || UnexpectedValue::Type { node, wanted };
        let Variant::Array(array) = self.good(node)? else { return Err(wrong()) };
        let taken: Option<Vec<T>> = array.values.iter().take(5).map(take).collect();
        taken.and_then(|taken| taken.try_into().ok()).ok_or_else(wrong)
    }
}

/// A value of good quality. Good quality with a qualifier, such as "overridden" or "clamped", is not accepted.
pub(super) fn variant(node: Node, value: &DataValue) -> Result<&Variant, UnexpectedValue> {
    let quality = value.status.unwrap_or(StatusCode::Good);
    if quality != StatusCode::Good {
        return Err(UnexpectedValue::Quality { node, quality });
    }
    value.value.as_ref().ok_or(UnexpectedValue::Type { node, wanted: "there" })
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

fn finite(node: Node, value: f64) -> Result<f64, UnexpectedValue> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(UnexpectedValue::Value { node, value: value.to_string(), why: "is not finite" })
    }
}

/// CEFACT's code of the millimetre, "MMT", as OPC UA encodes it.
pub(super) const MILLIMETRE: i32 = 0x4D_4D54;
/// CEFACT's code of the degree, "DD", as OPC UA encodes it.
pub(super) const DEGREE: i32 = 0x4444;

/// The unit that an axis must have.
pub(super) const fn unit(axis: Axis) -> i32 {
    match axis {
        Axis::X | Axis::Y | Axis::Z => MILLIMETRE,
        Axis::C => DEGREE,
    }
}

/// The attributes that [`units`] needs.
pub(super) fn asked_of_units() -> Vec<(Node, AttributeId)> {
    Axis::ALL.map(|axis| (Node::Unit(axis), AttributeId::Value)).into()
}

/// Checks that every axis has its unit.
pub(super) fn units(values: &[(Node, DataValue)]) -> Result<(), UnexpectedValue> {
    let answer = Answer::new(values);
    for axis in Axis::ALL {
        let node = Node::Unit(axis);
        let wrong = UnexpectedValue::Type { node, wanted: "a unit" };
        let Variant::ExtensionObject(object) = variant(node, answer.raw(node)?)? else { return Err(wrong) };
        let found = object.inner_as::<EUInformation>().ok_or(wrong)?.unit_id;
        if found != unit(axis) {
            let why = if axis == Axis::C { "is not the degree (17476)" } else { "is not the millimetre (5066068)" };
            return Err(UnexpectedValue::Value { node, value: format!("unit {found}"), why });
        }
    }
    Ok(())
}

/// Every node that the adaptor writes.
fn written() -> impl Iterator<Item = Node> {
    Node::COMMAND.into_iter().chain([Node::Pulse])
}

/// The attributes that [`writable`] needs.
pub(super) fn asked_of_commands() -> Vec<(Node, AttributeId)> {
    let attributes = [AttributeId::DataType, AttributeId::ValueRank, AttributeId::UserAccessLevel];
    written().flat_map(|node| attributes.map(|attribute| (node, attribute))).collect()
}

/// The type that a node must have, and whether it is an array of four values.
pub(super) const fn kind(node: Node) -> (DataTypeId, bool) {
    match node {
        Node::Fence => (DataTypeId::UInt64, false),
        Node::WatchdogMs => (DataTypeId::UInt32, false),
        Node::Targets | Node::Velocities => (DataTypeId::Double, true),
        _ => (DataTypeId::UInt16, false),
    }
}

/// Bit of the access level that allows writing a value.
const CURRENT_WRITE: u8 = 2;

/// Checks that every node of a command accepts the values that the adaptor would write.
pub(super) fn writable(values: &[(Node, DataValue)]) -> Result<(), UnexpectedValue> {
    let mut answers = values.iter();
    for node in written() {
        let mut next = || match answers.next() {
            Some((of, value)) if *of == node => variant(node, value),
            _ => Err(UnexpectedValue::Missing(node)),
        };
        let (data_type, rank, access) = (next()?, next()?, next()?);
        let (wanted, array) = kind(node);
        let wanted = NodeId::from(wanted);
        if !matches!(data_type, Variant::NodeId(found) if **found == wanted) {
            return Err(UnexpectedValue::Value {
                node,
                value: format!("of type {data_type}"),
                why: "docs/opcua.md has otherwise",
            });
        }
        // -1 is a scalar, 1 a one-dimensional array; -3, -2 and 0 do not specify this.
        if !matches!((rank, array), (Variant::Int32(-3..=-1), false) | (Variant::Int32(-3 | -2 | 0 | 1), true)) {
            let why = if array { "is no list" } else { "is a list" };
            return Err(UnexpectedValue::Value { node, value: format!("of rank {rank}"), why });
        }
        if !matches!(access, Variant::Byte(bits) if bits & CURRENT_WRITE != 0) {
            return Err(UnexpectedValue::Value {
                node,
                value: format!("of access {access}"),
                why: "does not let us write",
            });
        }
    }
    Ok(())
}
