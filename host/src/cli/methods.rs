//! Methods and settings of rendering as values of options: their names and what they are come from the
//! library.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use crate::render::{METHODS, Method};

/// A method, or none for `auto`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MethodArg(pub(super) Option<&'static Method>);

impl MethodArg {
    /// Whether it is the one of a name.
    pub(super) fn is(self, name: &str) -> bool {
        self.0.is_some_and(|method| method.name == name)
    }
}

/// The names of all methods, and `auto`.
pub(super) fn or_auto() -> impl TypedValueParser<Value = MethodArg> {
    let auto = PossibleValue::new("auto").help(
        "The cheapest that meets --max-error; without it `lights` when there is a GPU and no environment, \
         else `reference`",
    );
    PossibleValuesParser::new(std::iter::once(auto).chain(METHODS.iter().map(value)))
        .map(|name| MethodArg(Method::find(&name)))
}

/// The names of methods that bake.
pub(super) fn that_bake() -> impl TypedValueParser<Value = MethodArg> {
    PossibleValuesParser::new(METHODS.iter().filter(|method| method.bakes).map(value))
        .map(|name| MethodArg(Method::find(&name)))
}

fn value(method: &Method) -> PossibleValue {
    PossibleValue::new(method.name).help(format!("{}: {}", method.summary, method.draws))
}

/// One of some settings, each with its name and what it is.
pub(super) fn options<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    option: fn(T) -> (&'static str, &'static str),
) -> impl TypedValueParser<Value = T> {
    let value = move |one: &T| PossibleValue::new(option(*one).0).help(option(*one).1);
    PossibleValuesParser::new(all.iter().map(value)).map(move |name| {
        // Only these names come here.
        all.iter().copied().find(|one| option(*one).0 == name).unwrap_or(all[0])
    })
}
