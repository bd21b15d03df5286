//! Places in a vector, by names.

/// Constants that count from 0.
macro_rules! places {
    ($($place:ident),+ $(,)?) => {
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum Place { $($place),+ }
        $(pub const $place: usize = Place::$place as usize;)+
    };
}

/// Names in order, and a module `at` of their places.
macro_rules! named_places {
    ($(#[$told:meta])* $names:ident: $($place:ident $name:literal,)+) => {
        $(#[$told])*
        pub const $names: [&str; [$($name),+].len()] = [$($name),+];
        /// Places of the names.
        #[allow(missing_docs)]
        pub mod at {
            $crate::places::places! { $($place),+ }
        }
    };
}

pub(crate) use {named_places, places};
