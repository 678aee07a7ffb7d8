//! The demo's page.

/// A rendered picture.
pub struct Rendered {
    /// Title.
    pub title: String,
    /// Caption.
    pub caption: String,
    /// The PNG file.
    pub png: Vec<u8>,
}
