//! The arguments of XLA to a function of ours: the part of its C interface that a step needs, of version 0.1
//! (xla/ffi/api/c_api.h). Later minor versions add fields behind those that are read here.

use std::ffi::{c_char, c_int, c_void};

/// Major version of the interface used here.
pub(super) const MAJOR: c_int = 0;
pub(super) const MINOR: c_int = 1;

/// `XLA_FFI_Extension_Metadata`.
pub(super) const METADATA: c_int = 1;
/// `XLA_FFI_ExecutionStage_EXECUTE`.
pub(super) const EXECUTE: c_int = 3;
/// `XLA_FFI_AttrType_SCALAR`.
pub(super) const SCALAR: c_int = 3;
/// Values of `XLA_FFI_DataType`.
pub(super) const PRED: c_int = 1;
pub(super) const S32: c_int = 4;
pub(super) const S64: c_int = 5;
pub(super) const F32: c_int = 11;
/// `XLA_FFI_Error_Code_INVALID_ARGUMENT`.
pub(super) const INVALID_ARGUMENT: c_int = 3;

#[repr(C)]
pub(super) struct ExtensionBase {
    pub(super) struct_size: usize,
    pub(super) kind: c_int,
    pub(super) next: *mut ExtensionBase,
}

#[repr(C)]
pub(super) struct ApiVersion {
    pub(super) struct_size: usize,
    pub(super) extension_start: *mut ExtensionBase,
    pub(super) major: c_int,
    pub(super) minor: c_int,
}

#[repr(C)]
pub(super) struct Metadata {
    pub(super) struct_size: usize,
    pub(super) api_version: ApiVersion,
}

#[repr(C)]
pub(super) struct MetadataExtension {
    pub(super) base: ExtensionBase,
    pub(super) metadata: *mut Metadata,
}

#[repr(C)]
pub(super) struct ErrorCreate {
    pub(super) struct_size: usize,
    pub(super) extension_start: *mut ExtensionBase,
    pub(super) message: *const c_char,
    pub(super) code: c_int,
}

#[repr(C)]
pub(super) struct Api {
    pub(super) struct_size: usize,
    pub(super) extension_start: *mut ExtensionBase,
    pub(super) version: ApiVersion,
    pub(super) internal: *const c_void,
    pub(super) create_error: unsafe extern "C" fn(*mut ErrorCreate) -> *mut c_void,
}

/// Arguments and results alike.
#[repr(C)]
pub(super) struct Buffers {
    pub(super) struct_size: usize,
    pub(super) extension_start: *mut ExtensionBase,
    pub(super) size: i64,
    pub(super) kinds: *const c_int,
    pub(super) buffers: *const *const Buffer,
}

#[repr(C)]
pub(super) struct Buffer {
    pub(super) struct_size: usize,
    pub(super) extension_start: *mut ExtensionBase,
    pub(super) dtype: c_int,
    pub(super) data: *mut c_void,
    pub(super) rank: i64,
    pub(super) dims: *const i64,
}

#[repr(C)]
pub(super) struct Attributes {
    pub(super) struct_size: usize,
    pub(super) extension_start: *mut ExtensionBase,
    pub(super) size: i64,
    pub(super) kinds: *const c_int,
    pub(super) names: *const *const c_void,
    pub(super) values: *const *const Scalar,
}

#[repr(C)]
pub(super) struct Scalar {
    pub(super) dtype: c_int,
    pub(super) value: *const c_void,
}

#[repr(C)]
pub(super) struct CallFrame {
    pub(super) struct_size: usize,
    pub(super) extension_start: *mut ExtensionBase,
    pub(super) api: *const Api,
    pub(super) context: *mut c_void,
    pub(super) stage: c_int,
    pub(super) arguments: Buffers,
    pub(super) results: Buffers,
    pub(super) attributes: Attributes,
}

impl Buffer {
    /// Numbers in it.
    ///
    /// # Safety
    /// It is one of XLA's, of a call that is under way.
    #[allow(unsafe_code)]
    pub(super) unsafe fn len(&self) -> usize {
        if self.rank == 0 {
            return 1;
        }
        // SAFETY: XLA promises `rank` numbers
        let dims = unsafe { std::slice::from_raw_parts(self.dims, self.rank as usize) };
        dims.iter().product::<i64>() as usize
    }
}
