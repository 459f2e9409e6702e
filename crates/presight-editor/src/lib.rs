//! The visual feature editor: a [`Session`] that answers messages, and a page that sends them.
//!
//! The session holds a scene, a sensor and the layer that is edited. It takes the name of a message and its JSON, and
//! answers JSON or one binary body; it knows neither the network nor the page. [`http`] serves the page and passes
//! messages on. Another carrier, such as a worker in a browser, needs the same one function, [`Session::answer`].
//!
//! | message | answers |
//! |---|---|
//! | `state` | names, counts, sensor, outputs, pose, and what can be undone or saved |
//! | `features` | the layer in columns, for lists |
//! | `entry` | one feature, as in a layer file |
//! | `frame` | images of a pose, with the lines of the visible features (binary) |
//! | `regions` | regions of interest at a pose (binary) |
//! | `why` | for some features, the reasons why they are not visible |
//! | `pick` | what a pixel sees, and the features that may be made there |
//! | `change`, `generate`, `undo`, `redo` | one step each; they carry the version that the page knows |
//! | `restore` | the steps of a session that ended before it saved: taken or dropped |
//! | `plan` | a cut through the scene, from above (binary) |
//! | `worth` | the next places of the map of `presight features --worth` |
//! | `save` | writes the layer |

mod answer;
mod edit;
mod frame;
pub mod http;
mod map;
mod save;
mod session;

pub use answer::Answer;
pub use session::{Session, SessionOptions};
