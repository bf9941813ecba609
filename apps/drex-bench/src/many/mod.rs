//! One network over many objects: objects of many categories, verified grasps of them, and how the network does on categories that it has not seen.

mod data;
mod shapes;
mod unseen;

pub use data::{DataOptions, at_rest, grasped_object, kept};
pub use shapes::{Category, graspable};
pub use unseen::{UnseenOptions, UnseenRow, unseen};
