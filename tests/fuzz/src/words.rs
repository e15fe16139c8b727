//! Keywords of file formats, for mutations.

/// Kind of keywords.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Words {
    /// Numbers in text.
    Numbers,
    /// JSON syntax and values.
    Json,
    /// TOML syntax and names of settings.
    Toml,
    /// Names in camera files.
    Cameras,
    /// PLY headers.
    Ply,
    /// glTF names and values.
    Gltf,
    /// NumPy headers.
    Npy,
    /// EXR attributes.
    Exr,
    /// PNG chunks.
    Png,
    /// JPEG markers.
    Jpeg,
    /// Safetensors headers and this project's metadata.
    Tensors,
    /// Lights and edits.
    Light,
    /// Provider messages.
    Provider,
    /// Files of runs.
    Run,
    /// HTTP requests.
    Http,
}

impl Words {
    /// Returns the keywords of this kind.
    pub fn list(self) -> &'static [&'static [u8]] {
        macro_rules! words {
            ($($word:literal)*) => { const { &[$($word.as_bytes()),*] } };
        }
        match self {
            Words::Numbers => words!(
                "0" "-0" "1" "-1" "0.5" "2" "3" "7" "8" "16" "255" "256" "32767" "65535" "65536" "65537" "2147483647" "2147483648"
                "4294967295" "4294967296" "9007199254740993" "9223372036854775807" "18446744073709551615" "18446744073709551616"
                "1e9" "1e15" "1e38" "3.5e38" "1e39" "1e300" "1e308" "1e999" "-1e999" "1e-45" "1e-320" "nan" "NaN" "-nan" "inf"
                "-inf" "Infinity" "0x10" "1_000" "+1" "00" "." "-" "1e" "340282350000000000000000000000000000000"
            ),
            Words::Json => words!(
                "null" "true" "false" "[]" "{}" "\"\"" "[[" "]]" "{\"a\":" "," ":" "[" "]" "{" "}" "\"" "\\u0000" "\\ud800" "\\n"
                "\"..\"" "\"/\"" "\"../../x\"" "\"\\\\\"" "\u{feff}" "\u{0}" "\u{1b}[31m" "//" "1e999" "-1" "[1,2,3]" "[[[[[[[["
                "{\"a\":{\"a\":{\"a\":" "\u{fffd}" "é" "\"con.\""
            ),
            Words::Toml => words!(
                "[geometry]" "[geometry.rates]" "[geometry.losses]" "[geometry.densify]" "[intrinsic]" "[intrinsic.lights]"
                "[intrinsic.environment]" "[intrinsic.visibility]" "[intrinsic.losses]" "[intrinsic.rates]" "[provider]" "[memory]"
                "[accuracy]" "[train]" "[noise]" "[geometry.pseudo]" "[intrinsic.relight]" "[intrinsic.automatic]" "\nparts = [\"lobes\"]" "\nsteps = " "\nsteps = 0" "\nscale = "
                "\nseed = " "\nviews = " "\nsh_degree = " "\nresolution = " "\nbudget = " "\nkind = " "\ncommand = " "\nbackground = "
                "[[a]]" "[a.b.c]" "a.b.c = 1" "\"\" = 1" "'''" "\"\"\"" "= {" "{ a = 1 }" "[ 1, 2, 3 ]" "1979-05-27T07:32:00Z"
                "07:32:00" "0b1" "0o7" "\\u0000" "\r\n" "\n" "a.a.a.a.a.a.a.a." "[[[[[[[[" "{a={a={a=" "on_divergence = " "\nx = -1"
            ),
            Words::Cameras => words!(
                "\"frames\"" "\"file_path\"" "\"transform_matrix\"" "\"w\"" "\"h\"" "\"width\"" "\"height\"" "\"fl_x\"" "\"fl_y\""
                "\"cx\"" "\"cy\"" "\"camera_angle_x\"" "\"camera_angle_y\"" "\"camera_model\"" "\"is_fisheye\"" "\"k1\"" "\"k2\""
                "\"k3\"" "\"k4\"" "\"p1\"" "\"p2\"" "\"split\"" "\"train\"" "\"test\"" "\"val\"" "\"ply_file_path\"" "\"OPENCV\""
                "\"OPENCV_FISHEYE\"" "\"frame\"" "\"world\"" "\"camera-opencv\"" "\"normal\"" "\"labels\"" "\"dim\"" "\"images/000.png\""
                "PINHOLE" "SIMPLE_PINHOLE" "SIMPLE_RADIAL" "RADIAL" "OPENCV" "FULL_OPENCV" "FOV" "SIMPLE_DIVISION" "DIVISION" "FISHEYE"
                "EUCM" "RAD_TAN_THIN_PRISM_FISHEYE" "EQUIRECTANGULAR" "000.png" "001.png" "\n" " " "#" "\t"
                "\"images/\"" "images\\\\000.png" "\"points.ply\"" "\"000\"" "\"001\"" "\"mask_path\"" "\"depth_file_path\""
                "\"depth_unit_scale_factor\"" "\"mask/000.png\"" "\"depth/000.png\"" "OPENCV_FISHEYE" "THIN_PRISM_FISHEYE"
                "SIMPLE_RADIAL_FISHEYE" "RADIAL_FISHEYE" "SIMPLE_FISHEYE" "rgb/1.0.png" "rgb/2.0.png" "depth/1.0.png"
            ),
            Words::Ply => words!(
                "ply\n" "format ascii 1.0\n" "format binary_little_endian 1.0\n" "format binary_big_endian 1.0\n" "comment \n"
                "element vertex " "element face 1\n" "element x 4294967295\n" "element vertex 18446744073709551615\n"
                "property float x\n" "property double y\n" "property uchar red\n" "property char z\n" "property float nx\n"
                "property list uchar int i\n" "property short f_rest_0\n" "property uchar roughness\n" "property float albedo_0\n"
                "property float semantic_0\n" "property float metallic\n" "property float emitter\n" "property float roughnessFactor\n"
                "property float base_color_0\n" "property float normal_0\n" "property float semantic_feature_0\n" "end_header\n"
                "obj_info\n" "\r\n" "nan " "inf " "1e39 " "f_rest_44" "opacity" "rot_0" "scale_2"
            ),
            Words::Gltf => words!(
                "glTF" "JSON" "BIN\0" "\"asset\"" "\"version\":\"2.0\"" "\"accessors\"" "\"bufferViews\"" "\"buffers\"" "\"meshes\""
                "\"nodes\"" "\"scenes\"" "\"scene\"" "\"children\"" "\"mesh\"" "\"matrix\"" "\"translation\"" "\"rotation\"" "\"scale\""
                "\"byteOffset\"" "\"byteLength\"" "\"byteStride\"" "\"count\"" "\"componentType\"" "\"type\"" "\"VEC3\"" "\"VEC4\""
                "\"SCALAR\"" "5120" "5121" "5122" "5123" "5126" "\"normalized\":true" "\"uri\":\"data:;base64,AAAA\"" "\"uri\":\"scene.bin\""
                "\"KHR_gaussian_splatting\"" "\"KHR_gaussian_splatting_compression_spz_2\"" "\"bufferView\"" "\"KHR_lights_punctual\"" "\"extras\"" "\"sgs\"" "\"lobes\"" "\"_RAW_SCALE\"" "\"_ALBEDO\""
                "\"_SEMANTIC_0\"" "\"_NORMAL\"" "\"POSITION\"" "\"sparse\":{}" "\"mode\":0" "\"extensionsRequired\":[\"x\"]"
            ),
            Words::Npy => words!(
                "'descr': '<f4'" "'<f2'" "'<f8'" "'|u1'" "'|b1'" "'<u2'" "'<i4'" "'<i8'" "'>f4'" "'fortran_order': True"
                "'shape': (" "(0, 0, 0)" "(1,)" "()" "(4294967296, 4294967296)" "(1, 1, 1, 1)" "(3, 6, 8)" "'shape'" "\x01\x00"
                "\x02\x00" "\x03\x00" "(0, 1)" "(18446744073709551615, 2)"
            ),
            Words::Exr => words!(
                "channels\0chlist\0" "compression\0compression\0" "dataWindow\0box2i\0" "displayWindow\0box2i\0" "lineOrder\0lineOrder\0"
                "tiles\0tiledesc\0" "type\0string\0" "scanlineimage" "tiledimage" "deepscanline" "chunkCount\0int\0" "name\0string\0"
                "R\0" "G\0" "B\0" "A\0" "preview\0preview\0" "multiView\0stringvector\0" "version\0int\0" "\0\0\0\0" "\x01\0\0\0"
                "\0\0\x01\0" "\x02\0\0\0"
            ),
            Words::Png => words!(
                "IHDR" "IDAT" "PLTE" "tRNS" "IEND" "gAMA" "iCCP" "acTL" "fcTL" "fdAT" "zTXt" "iTXt" "eXIf" "cHRM" "sBIT" "pHYs" "\0\0\0\0"
                "\0\0\0\r" "\x10\x06" "\x08\x03" "\x01\0" "\x04\x03"
            ),
            Words::Jpeg => &[
                b"\xff\xd8",
                b"\xff\xc0",
                b"\xff\xc1",
                b"\xff\xc2",
                b"\xff\xc4",
                b"\xff\xda",
                b"\xff\xdb",
                b"\xff\xdd",
                b"\xff\xd0",
                b"\xff\xd9",
                b"\xff\xe0",
                b"\xff\xe1",
                b"\xff\xe2",
                b"\xff\xee",
                b"\xff\xff",
                b"\xff\x00",
                b"ICC_PROFILE\0",
                b"Exif\0\0",
                b"\x08\xff\xff\xff\xff\x03",
                b"\x01\x44\x00",
                b"\x02\x11\x01",
                b"\xff\xc3",
                b"\xff\xc9",
                b"Adobe",
            ],
            Words::Tensors => words!(
                "\"__metadata__\":" "\"dtype\":\"F32\"" "\"F16\"" "\"U8\"" "\"U32\"" "\"BOOL\"" "\"U16\"" "\"F4\"" "\"F64\"" "\"I64\"" "\"shape\":[" "\"shape\":[]"
                "\"data_offsets\":[0,0]" "[0,4]" "[4,0]" "[0]" "\"format\":\"sgs-semantics-1\"" "\"sgs-visibility-1\"" "\"sgs-lpips-1\""
                "\"sgs-geometry-1\"" "\"labels\":\"[]\"" "\"temperature\":\"0\"" "\"temperature\":\"nan\"" "\"levels\":\"16\""
                "\"log2_table\":\"22\"" "\"coarsest\":\"2\"" "\"finest\":\"65536\"" "\"net\":\"alex\"" "\"net\":\"vgg\"" "\"decoder\""
                "\"step\":\"4294967295\"" "\"capacity\":\"0\"" "\"watch\":\"" "ffffffffffffffff " "ffffffff " "\"roll_backs\":\"[]\""
                "\"sgs-intrinsic-1\"" "\"splats\":\"2\"" "\"lobes\":\"33\"" "\"texels\":\"16\"" "\"update_interval\":\"8 4294967295 0\"" "\"decisions\":\"[]\""
                "\"environment_after_4294967295\"" "\"relit_queried_at\"" "\"last_error\":\"-0\""
            ),
            Words::Light => words!(
                "\"format\"" "\"sgs-lights-1\"" "\"sgs-lights-2\"" "\"normalizer\"" "\"lights\"" "\"position\"" "\"gain\"" "\"lobes\"" "\"axis\"" "\"sharpness\""
                "\"amplitude\"" "\"off\"" "\"only\"" "\"change\"" "\"add\"" "\"light\"" "\"on\"" "\"by\"" "\"to\"" "\"color\"" "\"intensity\""
                "\"corners\"" "\"radiance\"" "\"patches\"" "\"environment\"" "\"file\"" "\"rotate\"" "\"degrees\"" "\"materials\""
                "\"where\"" "\"box\"" "\"gaussians\"" "\"class\"" "\"region\"" "\"view\"" "\"id\"" "\"set\"" "\"scale\"" "\"albedo\"" "\"roughness\""
                "\"metallic\"" "\"insert\"" "\"source\"" "\"rotation\"" "\"translation\"" "[0,0,0]" "[0,0,0,0]" "[1,1,1]" "[1e38,1e38,1e38]"
                "\"training\"" "\"relight\"" "\"point_light_intensity_equivalent\"" "\"instance_id\"" "\"new_base_color_linear\""
                "\"sgs-emitters-1\"" "\"enclosure\"" "\"low\"" "\"high\"" "\"surfels\"" "\"rays\"" "\"emitters\"" "\"name\"" "\"shape\"" "\"type\""
                "\"point\"" "\"sphere\"" "\"rectangle\"" "\"disk\"" "\"spot\"" "\"directional\"" "\"lobe\"" "\"center\"" "\"radius\"" "\"corner\""
                "\"edge_u\"" "\"edge_v\"" "\"normal\"" "\"inner_angle\"" "\"outer_angle\"" "\"direction\"" "\"angular_radius\""
            ),
            Words::Provider => words!(
                "SGSP" "\\\"kind\\\":\\\"hello\\\"" "\\\"kind\\\":\\\"answer\\\"" "\\\"kind\\\":\\\"error\\\"" "\\\"version\\\":1" "\\\"offers\\\":{}" "\\\"to\\\":1"
                "\\\"name\\\":" "\\\"masks\\\":{}" "\\\"regions\\\":{}" "\\\"normals\\\":{}" "\\\"semantics\\\":{}" "\\\"text\\\":{}" "\\\"classes\\\":{}"
                "\\\"materials\\\":{}" "\\\"image\\\":\\\"linear\\\"" "\\\"max_side\\\":8" "\\\"max_side\\\":1048576" "\\\"channels\\\":1" "\\\"ids\\\":\\\"scene\\\""
                "\\\"frame\\\":\\\"world\\\"" "\\\"color\\\":\\\"srgb\\\"" "\\\"names\\\":[]" "\\\"text\\\":\\\"" "\"BOOL\"" "\"U16\"" "\"F16\"" "\"F32\"" "\"shape\":[0]"
            ),
            Words::Run => words!(
                "\"step\":" "\"stage\":\"intrinsic\"" "\"loss\":" "\"test\"" "\"train\"" "\"mean\"" "\"views\"" "\"nvs\"" "\"psnr\"" "\"relit\""
                "\"resumed_from\":0" "\"intrinsic\"" "\"steps_per_second\"" "\"gaussians\"" "\"traceEvents\"" "\"ph\":\"X\"" "\"dur\":" "\"name\":"
                "\n" "\r\n" "\"seconds\"" "\"peak_device_bytes\"" "\"lpips\"" "\"sgs-cameras-1\"" "\"lens\"" "\"focal\"" "\"center\""
                "\"vignetting\"" "\"distortion\"" "\"world_to_camera\"" "\"gains\"" "\"000\""
            ),
            Words::Http => words!(
                "GET " "HEAD " "POST " "/ " "/live" "?images=1" " HTTP/1.1\r\n" " HTTP/1.0\r\n" "\r\n" "\r\n\r\n" "Host: 127.0.0.1:8117\r\n" "localhost:8117"
                "localhost" ":8117" "Content-Length: " "Transfer-Encoding: chunked\r\n" "Expect: 100-continue\r\n" "Connection: " "a: b\r\n" "\n" "http://" "%00"
            ),
        }
    }
}
