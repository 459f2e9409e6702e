//! Occupancy grids against dense rays.

use super::lost::room;
use super::rooms::{explore, sensor, views_of};
use super::rough::looks;
use glam::{DVec3, Vec3};
use presight_explore::Known;
use presight_explore::occupancy::{Cell, Grid, GridOptions};
use presight_model::environment::{Environment, Mark, MarkKind, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::{Aabb, Pose};
use presight_testkit::oracle::Oracle;
use presight_testkit::scenes::{cuboid, empty};

/// A floor of 3 x 2 m with a hole of a cell, a turned box on it, a lamp above the robot, and a thin slanted plate.
fn hall() -> Environment {
    let mut environment = empty();
    let mut add = |name: &str, mesh: Mesh, pose: Pose| {
        environment.insert(NewObject::new(name, pose, mesh.into())).unwrap();
    };
    let flat = |corners: Vec<[f32; 3]>| {
        let polygon = Polygon::new((0..corners.len() as u32).collect(), 0);
        Mesh::new("flat", corners.into_iter().map(Vec3::from).collect(), vec![polygon], PolygonOrder::Given).unwrap()
    };
    add("left", flat(vec![[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [1.0, 2.0, 0.5], [0.0, 2.0, 0.5]]), Pose::IDENTITY);
    add("right", flat(vec![[1.1, 0.0, 0.5], [3.0, 0.0, 0.5], [3.0, 2.0, 0.5], [1.1, 2.0, 0.5]]), Pose::IDENTITY);
    let turned = Pose::from_xyz_rpy(DVec3::new(2.0, 1.0, 0.5), 0.0, 0.0, 0.6);
    add("box", cuboid(Vec3::new(-0.3, -0.2, 0.0), Vec3::new(0.3, 0.2, 0.8)), turned);
    add("lamp", cuboid(Vec3::new(0.2, 0.2, 2.6), Vec3::new(0.6, 0.6, 2.7)), Pose::IDENTITY);
    add("plate", flat(vec![[0.3, 1.2, 0.5], [0.8, 1.33, 0.5], [0.8, 1.33, 1.1], [0.3, 1.2, 1.1]]), Pose::IDENTITY);
    environment
}

/// Cells that are said to be free although a ray across them, between the heights, ends in them, `inside` metres from
/// their borders.
fn wrongly_free(environment: &Environment, grid: &Grid, options: &GridOptions, inside: f64) -> usize {
    let oracle = Oracle::new(environment, DVec3::ZERO).unwrap();
    let is_hit = |cell: usize| {
        let at = glam::DVec2::new((cell % grid.width) as f64, (cell / grid.width) as f64);
        let (corner, side) = (grid.origin + at * grid.cell + inside, grid.cell - 2.0 * inside);
        (0..9 * 8).any(|k| {
            let (across, up) = (0.5 + (k % 9) as f64, (k / 9) as f64 / 7.0);
            let z = grid.floor + options.from_height + up * (options.to_height - options.from_height);
            let at = across / 9.0 * side;
            let along = oracle.hides(DVec3::new(corner.x, corner.y + at, z), DVec3::X, side, &[]);
            along || oracle.hides(DVec3::new(corner.x + at, corner.y, z), DVec3::Y, side, &[])
        })
    };
    (0..grid.cells.len()).filter(|c| grid.cells[*c] == Cell::Free && is_hit(*c)).count()
}

#[test]
fn no_occupied_cell_is_free_and_no_floor_is_unknown() {
    let (environment, options) = (hall(), GridOptions::default());
    let mut grid = Grid::of(&environment, &options).unwrap();
    assert_eq!(wrongly_free(&environment, &grid, &options, 0.0), 0);
    let at = |grid: &Grid, x: f64, y: f64| {
        let cell = (glam::DVec2::new(x, y) - grid.origin) / grid.cell;
        grid.cells[cell.y as usize * grid.width + cell.x as usize]
    };
    // By hand: a free floor below the lamp, the box, the gap between the floors, and what lies outside.
    assert!((grid.floor - 0.5).abs() < 1e-9);
    assert_eq!(at(&grid, 0.4, 0.4), Cell::Free);
    assert_eq!(at(&grid, 1.05, 1.0), Cell::Unknown);
    assert_eq!(at(&grid, -0.02, 1.0), Cell::Unknown);
    assert_eq!(at(&grid, 0.55, 1.265), Cell::Occupied);
    let occupied = grid.cells.iter().position(|c| *c == Cell::Occupied).unwrap();
    grid.cells[occupied] = Cell::Free;
    assert_eq!(wrongly_free(&environment, &grid, &options, 0.0), 1, "planted");
}

/// What a robot explored is a map for planners: no cell that is occupied in the real room is free in it. Surfaces that
/// end within 3 mm of the next cell do not count: they are as far off.
#[test]
fn an_explored_room_has_no_free_cell_that_is_occupied() {
    let real = room();
    let views = views_of(&sensor(), looks(24, 0.0).map(|pose| (real.clone(), pose)));
    let found = explore(&Environment::new(), Known::Explored, &views);
    let options = GridOptions::default().with_cell(0.07);
    let mut grid = Grid::of(found.environment(), &options).unwrap();
    assert!(grid.count(Cell::Free) > 1000, "{}", grid.count(Cell::Free));
    assert_eq!(wrongly_free(&real, &grid, &options, 0.003), 0);
    grid.cells.fill(Cell::Free);
    assert!(wrongly_free(&real, &grid, &options, 0.003) > 100, "planted");
}

/// No cell is free in a space that a mark records as unobserved between the heights. A mark below the heights has no
/// effect.
#[test]
fn what_nobody_saw_is_unknown() {
    let (mut environment, options) = (hall(), GridOptions::default());
    let before = Grid::of(&environment, &options).unwrap();
    let mut marked = |name: &str, low: f64, high: f64| {
        let bounds = Aabb { min: DVec3::new(0.21, 0.21, low), max: DVec3::new(0.29, 0.29, high) };
        let mark = Mark { object: "left".into(), kind: MarkKind::Unseen, class: None, bounds: Some(bounds) };
        environment.set_mark(name, mark).unwrap();
        Grid::of(&environment, &options).unwrap()
    };
    assert_eq!(marked("low", 0.5, 0.55).cells, before.cells);
    // By hand: cells of 5 cm from 0.21 to 0.29 are two by two.
    let after = marked("high", 0.5, 1.0);
    assert_eq!(before.count(Cell::Free) - after.count(Cell::Free), 4);
    assert_eq!(after.count(Cell::Unknown) - before.count(Cell::Unknown), 4);
}

/// A mark that an object is absent for all sensors takes it out of the grid; one for lasers alone does not.
#[test]
fn what_is_marked_absent_is_not_in_the_way() {
    let (mut environment, options) = (empty(), GridOptions::default());
    environment
        .insert(NewObject::new(
            "floor",
            Pose::IDENTITY,
            cuboid(Vec3::new(-2.0, -2.0, -0.1), Vec3::new(2.0, 2.0, 0.0)).into(),
        ))
        .unwrap();
    let bare = Grid::of(&environment, &options.with_floor(Some(0.0))).unwrap();
    let crate_mesh = cuboid(Vec3::new(0.2, 0.2, 0.0), Vec3::new(1.2, 1.2, 1.0));
    environment.insert(NewObject::new("crate", Pose::IDENTITY, crate_mesh.into())).unwrap();
    let mut with = |class: Option<&str>| {
        let mark = Mark { object: "crate".into(), kind: MarkKind::Absent, class: class.map(Into::into), bounds: None };
        environment.set_mark("gone", mark).unwrap();
        Grid::of(&environment, &options.with_floor(Some(0.0))).unwrap()
    };
    assert!(with(Some("laser")).count(Cell::Occupied) > 0);
    let absent = with(None);
    assert_eq!((absent.cells, absent.origin), (bare.cells, bare.origin));
}

/// By the rules of map_server: p = (255 - grey) / 255 is occupied above 0.65, free below 0.196, unknown between.
#[test]
fn the_files_mean_what_map_server_reads() {
    let grid = Grid::of(&hall(), &GridOptions::default()).unwrap();
    let pgm = grid.pgm();
    let header = format!("P5\n{} {}\n255\n", grid.width, grid.height);
    assert!(pgm.starts_with(header.as_bytes()));
    let pixels = &pgm[header.len()..];
    assert_eq!(pixels.len(), grid.cells.len());
    let read = |grey: u8| match f64::from(255 - grey) / 255.0 {
        p if p > 0.65 => Cell::Occupied,
        p if p < 0.196 => Cell::Free,
        _ => Cell::Unknown,
    };
    for (k, cell) in grid.cells.iter().enumerate() {
        // The first row of the image is the one with the greatest y.
        let (column, row) = (k % grid.width, grid.height - 1 - k / grid.width);
        assert_eq!(read(pixels[row * grid.width + column]), *cell);
    }
    let yaml = grid.yaml("hall.pgm");
    for line in ["image: \"hall.pgm\"", "resolution: 0.05", "negate: 0", "mode: trinary", "free_thresh: 0.196"] {
        assert!(yaml.lines().any(|l| l == line), "{yaml}");
    }
}

#[test]
fn too_many_cells_are_refused_with_a_cell_that_works() {
    let options = GridOptions::default().with_cell(1e-5);
    let refused = Grid::of(&hall(), &options).unwrap_err().to_string();
    let cell: f64 = refused.split("at least ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!(Grid::of(&hall(), &GridOptions::default().with_cell(cell)).is_ok(), "{refused}");
    assert!(Grid::of(&Environment::new(), &GridOptions::default()).is_err());
    assert!(Grid::of(&hall(), &GridOptions::default().with_from_height(2.0)).is_err());
}

fn at(x: f64, y: f64, z: f64) -> Pose {
    Pose::from_xyz_rpy(DVec3::new(x, y, z), 0.0, 0.0, 0.0)
}

/// Number of cells of 0.1 m in each state that a grid of boxes has: free, occupied, unknown.
fn counts(environment: &Environment, options: &GridOptions) -> [usize; 3] {
    let grid = Grid::of(environment, &options.with_cell(0.1)).unwrap();
    [Cell::Free, Cell::Occupied, Cell::Unknown].map(|cell| grid.count(cell))
}

/// By hand: on a slab of 4 x 3 m (top at 0.01, 40 x 30 cells) stands a box of 0.98 x 0.98 m in the middle of 10 x 10
/// cells. The slab is up to 2 m thick, which is more than the robot is high: its underside is never the floor.
#[test]
fn the_floor_of_a_slab_is_its_top() {
    for thick in [0.02, 0.12, 0.3, 1.0, 2.5] {
        let mut environment = empty();
        environment.add_cuboid("slab", at(2.0, 1.5, 0.01 - 0.5 * thick), DVec3::new(4.0, 3.0, thick)).unwrap();
        environment.add_cuboid("box", at(1.5, 1.5, 0.51), DVec3::new(0.98, 0.98, 1.0)).unwrap();
        let grid = Grid::of(&environment, &GridOptions::default()).unwrap();
        assert!((grid.floor - 0.01).abs() < 1e-6, "{thick}: {}", grid.floor);
        assert_eq!(counts(&environment, &GridOptions::default())[..2], [1200 - 100, 100], "{thick}");
    }
    // The inside of a shell whose fronts point outward: nothing stands on top of it.
    let mut shell = empty();
    shell.add_cuboid("shell", at(2.0, 1.5, 1.5), DVec3::new(4.0, 3.0, 3.0)).unwrap();
    shell.add_cuboid("box", at(1.5, 1.5, 0.5), DVec3::new(0.98, 0.98, 1.0)).unwrap();
    let grid = Grid::of(&shell, &GridOptions::default()).unwrap();
    assert!(grid.floor.abs() < 1e-6 && !grid.levels[0].faces_up);
}

/// By hand: two storeys of 4 x 3 m at 0 and 3 m, a box on the upper one, and a table on the lower one.
#[test]
fn storeys_are_levels() {
    let mut environment = empty();
    for (name, z) in [("ground", -0.1), ("upper", 2.9)] {
        environment.add_cuboid(name, at(2.0, 1.5, z), DVec3::new(4.0, 3.0, 0.2)).unwrap();
    }
    environment.add_cuboid("box", at(1.5, 1.5, 3.5), DVec3::new(0.98, 0.98, 1.0)).unwrap();
    environment.add_cuboid("table", at(1.0, 1.0, 0.7), DVec3::new(0.38, 0.38, 0.05)).unwrap();
    let plain = GridOptions::default();
    let grid = Grid::of(&environment, &plain).unwrap();
    let heights: Vec<f64> = grid.levels.iter().map(|level| level.height).collect();
    // The top of the box has a twelfth of the area of a storey.
    let expected = [0.0, 3.0, 4.0];
    assert!(heights.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6) && heights.len() == 3, "{heights:?}");
    assert_eq!((grid.level, counts(&environment, &plain)[0]), (Some(1), 1200 - 16));
    for options in [plain.with_level(Some(2)), plain.with_floor(Some(3.0))] {
        assert_eq!(counts(&environment, &options)[..2], [1200 - 100, 100]);
    }
    let refused = Grid::of(&environment, &plain.with_level(Some(4))).unwrap_err().to_string();
    assert!(refused.contains("1 to 3") && refused.contains("0.000, 3.000, 4.000"), "{refused}");
    assert!(Grid::of(&environment, &plain.with_level(Some(0))).is_err());
    assert_eq!(counts(&environment, &plain.with_floor(Some(1.5)))[0], 0, "no level is there");
}

/// By hand: a crate of 0.98 x 0.98 m covers 10 x 10 cells, and a slab 40 x 30 of them. What hangs above the robot is
/// not in its way.
#[test]
fn a_keepout_mask_is_of_what_is_uncertain() {
    let mut environment = empty();
    environment.add_cuboid("slab", at(2.0, 1.5, -0.1), DVec3::new(3.99, 2.99, 0.2)).unwrap();
    environment.add_cuboid("crate", at(1.5, 1.5, 0.5), DVec3::new(0.98, 0.98, 1.0)).unwrap();
    environment.add_cuboid("lamp", at(3.5, 1.5, 2.5), DVec3::new(0.38, 0.38, 0.2)).unwrap();
    let options = GridOptions::default().with_cell(0.1);
    let mask = |environment: &Environment| {
        let grid = Grid::of(environment, &options).unwrap();
        let mask = grid.keepout(environment);
        assert_eq!((mask.width, mask.origin), (grid.width, grid.origin));
        assert_eq!(mask.count(Cell::Free) + mask.count(Cell::Occupied), mask.cells.len());
        mask.count(Cell::Occupied)
    };
    assert_eq!(mask(&environment), 0);
    let mut mark = |object: &str, kind: MarkKind| {
        let mark = Mark { object: object.into(), kind, class: None, bounds: None };
        environment.set_mark(object, mark).unwrap();
        mask(&environment)
    };
    assert_eq!(mark("lamp", MarkKind::Uncertain), 0, "above the robot");
    assert_eq!(mark("crate", MarkKind::Uncertain), 100);
    assert_eq!(mark("crate", MarkKind::Absent), 0);
    assert_eq!(mark("slab", MarkKind::Uncertain), 1200);
}

/// A hall of 8 x 6 m on a slab of 0.3 m, with walls beside the slab and a table. The numbers of cells are those of a
/// program of its own, by clipping and separating axes.
#[test]
fn a_hall_on_a_slab_has_the_cells_of_another_program() {
    let mut environment = empty();
    for (name, min, max) in [
        ("floor", [0.0, 0.0, -0.3], [8.0, 6.0, 0.0]),
        ("south", [0.0, -0.1, 0.0], [8.0, 0.0, 3.0]),
        ("north", [0.0, 6.0, 0.0], [8.0, 6.1, 3.0]),
        ("west", [-0.1, 0.0, 0.0], [0.0, 6.0, 3.0]),
        ("east", [8.0, 0.0, 0.0], [8.1, 6.0, 3.0]),
        ("table", [4.2, 1.6, 0.725], [5.8, 2.4, 0.775]),
    ] {
        let mesh = cuboid(Vec3::from(min), Vec3::from(max));
        environment.insert(NewObject::new(name, Pose::IDENTITY, mesh.into())).unwrap();
    }
    let grid = Grid::of(&environment, &GridOptions::default()).unwrap();
    assert_eq!((grid.floor, grid.count(Cell::Free), grid.count(Cell::Occupied)), (0.0, 18_032, 2_868));
}
