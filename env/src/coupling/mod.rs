//! Interactions of the drones of a world besides the air: knowledge of each other, and the load that they carry.

mod communication;
pub mod load;

pub(crate) use communication::Communication;
pub use communication::{Knowledge, NEIGHBOUR, NEIGHBOUR_FIELDS};

/// Most drones in a world.
pub const MOST_DRONES: usize = 64;
