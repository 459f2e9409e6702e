//! Tools for programs around presight: files that appear whole, limits, memory, threads and text.

#[doc(inline)]
pub use presight_model::limits::{
    MAX_COORDINATE, MAX_FILE_BYTES, MAX_IMAGE_SIDE, MAX_LINE_BYTES, MAX_SERIES, MAX_SHOWN,
};
#[doc(inline)]
pub use presight_model::memory::{FrameMemory, of_writing as memory_of_writing, require as require_memory, reserved};
#[doc(inline)]
pub use presight_model::plausible::{poses_far_outside, radians as notice_of_radians};
#[doc(inline)]
pub use presight_model::printable::{clipped, printable, quoted};
#[doc(inline)]
pub use presight_model::statistics::{median, quantile, upper_median};
#[doc(inline)]
pub use presight_model::threads::{PerProcess, this_process};
#[doc(inline)]
pub use presight_read::atomic::{is_given, refused as write_error, target_of, write_atomically};
#[doc(inline)]
pub use presight_read::file::{
    open as open_file, open_any as open_stream, read as read_file, starts_with as file_starts_with, without_mark,
};
#[doc(inline)]
pub use presight_read::growing::{GrowingFile, is_through};
#[doc(inline)]
pub use presight_read::temporary::{abandon as abandon_files, create_folder};
#[doc(inline)]
pub use presight_read::text::{check_name, read_settings, read_text};
