//! Named indices of a parameter vector.

/// Integer constants, numbered from 0.
macro_rules! places {
    ($($place:ident),+ $(,)?) => {
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum Place { $($place),+ }
        $(pub const $place: usize = Place::$place as usize;)+
    };
}

/// Names in order, and a module `at` of their indices.
macro_rules! named_places {
    ($(#[$told:meta])* $names:ident: $($place:ident $name:literal,)+) => {
        $(#[$told])*
        pub const $names: [&str; [$($name),+].len()] = [$($name),+];
        /// Indices of the names.
        #[allow(missing_docs)]
        pub mod at {
            $crate::places::places! { $($place),+ }
        }
    };
}

pub(crate) use {named_places, places};
