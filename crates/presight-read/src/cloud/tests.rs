use super::*;
use presight_model::error::ErrorKind;

fn read_bytes(name: &str, bytes: &[u8]) -> Result<Cloud> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    read(&path)
}

fn with(header: &str, body: &[u8]) -> Vec<u8> {
    [header.as_bytes(), body].concat()
}

const TWO: [DVec3; 2] = [DVec3::new(1.5, -2.0, 0.25), DVec3::new(3.0, 4.0, -1.0)];

/// Two points in every encoding; other fields lie between the coordinates.
#[test]
fn every_encoding_gives_the_same_points() {
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment by hand\nelement vertex 2\nproperty float x\nproperty uchar i\n\
             property double y\nproperty float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let binary = |little: bool| {
        let mut body = Vec::new();
        for p in TWO {
            let (x, y, z) = (p.x as f32, p.y, p.z as f32);
            if little {
                body.extend(x.to_le_bytes().iter().chain(&[7]).chain(&y.to_le_bytes()).chain(&z.to_le_bytes()));
            } else {
                body.extend(x.to_be_bytes().iter().chain(&[7]).chain(&y.to_be_bytes()).chain(&z.to_be_bytes()));
            }
        }
        body
    };
    let text = b"1.5 7 -2 0.25\n3 7 4 -1\n";
    assert_eq!(read_bytes("a.ply", &with(&header("ascii"), text)).unwrap().points, TWO);
    assert_eq!(read_bytes("a.PLY", &with(&header("binary_little_endian"), &binary(true))).unwrap().points, TWO);
    assert_eq!(read_bytes("a.ply", &with(&header("binary_big_endian"), &binary(false))).unwrap().points, TWO);
    let pcd = |data: &str| {
        format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x i y z\nSIZE 4 1 8 4\nTYPE F U F F\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\n\
             VIEWPOINT 1 2 3 1 0 0 0\nPOINTS 2\nDATA {data}\n"
        )
    };
    for cloud in [with(&pcd("ascii"), text), with(&pcd("binary"), &binary(true))] {
        let cloud = read_bytes("a.pcd", &cloud).unwrap();
        assert_eq!((cloud.points.as_slice(), cloud.size), (TWO.as_slice(), None));
        assert_eq!(cloud.pose.unwrap().world_from_sensor().translation, DVec3::new(1.0, 2.0, 3.0));
    }
    assert_eq!(read_bytes("a.csv", b"# by hand\n1.5,-2,0.25\n3,4,-1,9\n").unwrap().points, TWO);
    assert_eq!(read_bytes("a.csv", b"i,Z,y,X\n7,0.25,-2,1.5\n7,-1,4,3\n").unwrap().points, TWO);
}

#[test]
fn whole_numbers_keep_their_sign() {
    let header = "FIELDS x y z\nSIZE 2 1 8\nTYPE I U I\nWIDTH 1\nHEIGHT 1\nDATA binary\n";
    let body = [(-300i16).to_le_bytes().as_slice(), &[200], &(-5i64).to_le_bytes()].concat();
    assert_eq!(read_bytes("a.pcd", &with(header, &body)).unwrap().points, [DVec3::new(-300.0, 200.0, -5.0)]);
}

/// An organized cloud keeps its pixels; NaN is a missing measurement.
#[test]
fn organized_clouds_keep_their_pixels() {
    let header = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 2\nDATA ascii\n";
    let cloud = read_bytes("a.pcd", &with(header, b"1 0 0\n1 1 0\nnan 0 0\n2 0 1\n")).unwrap();
    assert_eq!(cloud.size, Some((2, 2)));
    assert!(cloud.points[2].is_nan() && cloud.points[3] == DVec3::new(2.0, 0.0, 1.0));
}

#[test]
fn what_is_wrong_is_named() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
               end_header\n1 2 3\n";
    assert!(read_bytes("a.ply", ply.as_bytes()).is_ok());
    let faults = [
        ("ply\n", "plyx\n", None),
        ("end_header\n", "", Some("no end_header")),
        ("1 2 3\n", "1 2\n", Some("bytes follow")),
        ("1 2 3\n", "1 2 north\n", Some("line 1 after its header")),
        ("vertex 1", "vertex 2", Some("bytes follow")),
        ("vertex 1", "vertex 99999999999", Some("the limit is")),
        ("vertex 1", "vertex -1", Some("number of its points")),
        ("property float z", "property float height", Some("no x, y and z")),
        ("property float z", "property list uchar int z", Some("lists")),
        ("element vertex", "element face 1\nelement vertex", Some("first element")),
        ("ascii", "runes", Some("runes")),
        ("1 2 3", "inf 2 3", Some("point 0")),
        ("1 2 3", "nan 2 3", Some("no point")),
    ];
    for (part, fault, what) in faults {
        assert!(ply.contains(part));
        let read = read_bytes("a.ply", ply.replace(part, fault).as_bytes());
        let Some(what) = what else { continue };
        let e = read.unwrap_err();
        assert!(e.file().is_some() && e.to_string().contains(what), "{fault}: {e}");
    }
    let pcd = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3\n";
    assert!(read_bytes("a.pcd", pcd.as_bytes()).is_ok());
    for (part, fault, what) in [
        ("SIZE 4 4 4", "SIZE 4 4", "differ in length"),
        ("TYPE F", "TYPE Q", "TYPE"),
        ("POINTS 1", "POINTS 2", "POINTS 2"),
        ("WIDTH 1", "WIDTH 99999999999999999999", "WIDTH"),
        ("DATA ascii", "DATA binary_compressed", "compressed"),
        ("POINTS 1", "VIEWPOINT 0 0 0 0 0 0 0", "VIEWPOINT"),
        ("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F", "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 9999999", "numbers"),
    ] {
        assert!(pcd.contains(part));
        let e = read_bytes("a.pcd", pcd.replace(part, fault).as_bytes()).unwrap_err();
        assert!(e.to_string().contains(what), "{fault}: {e}");
    }
    assert!(read_bytes("a.csv", b"1,2,3\n1,2\n").unwrap_err().to_string().contains("line 2"));
    assert!(read_bytes("a.csv", b"a,b,c\n1,2,3\n").unwrap_err().to_string().contains("line 1"));
    assert_eq!(read_bytes("a.xyz", b"1 2 3").unwrap_err().kind(), ErrorKind::Invalid);
}
