//! `drex grasp` and `drex deploy`.

use std::fs;

use drex_twin::records::{MassFile, read_json};

use crate::common::{PATIENT, drex, edit, keep_demonstrations, tin_copy};

#[test]
fn a_hand_whose_model_names_no_torques_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("quiet.xml");
    let text = drex_robot::Robot::bundled_mjcf("leap_right").unwrap();
    let text = text.replace(" forcerange=\"-0.95 0.95\"", "").replace(" actuatorfrcrange=\"-0.29 0.29\"", "");
    fs::write(&file, text.replace("model=\"leap_right\"", "model=\"quiet_hand\"")).unwrap();
    let (_guard, twin) = tin_copy();
    fs::copy(&file, twin.join("quiet.xml")).unwrap();
    keep_demonstrations(&twin, 1);
    let manifest = twin.join("twin.toml");
    edit(&manifest, "hand = \"leap_right\"", "hand = \"quiet.xml\"");
    drex(["train", twin.to_str().unwrap()]).fails_with(&["\"quiet_hand\"", "torque_cap_nm"]);
}

#[test]
fn a_trained_twin_grasps_and_deploys() {
    let (_guard, twin) = tin_copy();
    let at = twin.to_str().unwrap();
    drex(["grasp", at]).fails_with(&["no policy yet", "drex train"]);
    keep_demonstrations(&twin, 6);
    edit(&twin.join("twin.toml"), "hand = \"leap_right\"", "hand = \"leap_right\"\n\n[train]\nepochs = 40");
    assert_eq!(drex(["train", at]).code, 0);

    let pose = "0.4,0.1,0.2,1,0,0,0";
    let answer = drex(["grasp", at, "--json", "--mass", "0.2", "--pose", pose]).json();
    assert_eq!(answer["joints_rad"].as_array().unwrap().len(), 16);
    let palm: Vec<f64> =
        answer["world_from_base"]["translation_m"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!((palm[0] - 0.4).abs() < 0.3 && (palm[2] - 0.2).abs() < 0.4, "{palm:?}");
    assert!(answer["squeeze_n"].as_f64().unwrap() > 0.0 && answer["paper_force"].as_f64().unwrap() <= 1.0);
    // The hand closes on the object as it stands, wherever the world's origin is.
    let moved = drex(["grasp", at, "--json", "--mass", "0.2", "--pose", "0.1,-0.3,0.9,1,0,0,0"]).json();
    for same in ["contacts", "needed_squeeze_n", "joint_torques_nm", "joints_rad"] {
        assert_eq!(moved[same], answer[same], "{same}");
    }
    // Twice the mass is twice the paper's number, as long as the same fingers touch.
    assert_eq!(answer["mass_kg"], 0.2);

    // Of a friction that is not known the force is for the smoothest five in a hundred, or as many as the motors leave.
    let unknown =
        |friction: &[&str]| drex([&["grasp", at, "--json", "--mass", "0.2", "--pose", pose], friction].concat()).json();
    let between = unknown(&["--friction", "0.3,0.8"]);
    assert_eq!(between["friction_range"], serde_json::json!([0.3, 0.8]));
    let (risk, friction) = (between["risk"].as_f64().unwrap(), between["friction"].as_f64().unwrap());
    assert!((friction - (0.3 + 0.5 * risk)).abs() < 1e-6 && (0.05..=0.5).contains(&risk), "{risk} {friction}");
    assert!(answer["risk"].is_null() && answer["friction"] == 0.5 && unknown(&["--friction", "0.5"]) == answer);
    // Where the mass is what the push says, mass and friction are asked together.
    let joint = drex(["grasp", at, "--json", "--pose", pose, "--friction", "0.3,0.8"]).json();
    let number = |key: &str| joint[key].as_f64().unwrap();
    let likely_kg = read_json::<MassFile>(&twin.join("mass.json")).unwrap().likely_kg();
    let smoother =
        likely_kg.iter().map(|kg| ((kg * number("friction") / number("mass_kg") - 0.3) / 0.5).clamp(0.0, 1.0));
    let risk = smoother.sum::<f64>() / likely_kg.len() as f64;
    assert!((risk - number("risk")).abs() < 1e-6, "{risk} {joint}");
    edit(&twin.join("twin.toml"), "friction = 0.5", "# friction = 0.5");
    let unstated = unknown(&[]);
    assert_eq!(unstated, unknown(&["--friction", "0.3,0.8"]));
    // Of another manifest the object is made of its mesh anew, not read from what was written: the last digits of its forces are others.
    for same in ["friction", "friction_range", "risk", "joints_rad", "place"] {
        assert_eq!(unstated[same], between[same], "{same}");
    }
    edit(&twin.join("twin.toml"), "# friction = 0.5", "friction = 0.5");

    // Motors that give next to nothing carry nothing.
    let weak = drex(["grasp", at, "--json", "--torque-cap", "1e-3"]).json();
    assert!(weak["cannot_hold"].is_string() && weak["needed_squeeze_n"].is_null(), "{weak}");
    drex(["grasp", at, "--hand", "allegro_right"]).fails_with(&["policy is for the hand \"leap_right\"", "allegro"]);
    drex(["grasp", twin.join("policy/network").to_str().unwrap()]).fails_with(&["--mesh"]);
    drex(["grasp", at, "--mass", "1000"]).fails_with(&["1000"]);
    let policy = twin.join("policy/network/policy.json");
    let version = fs::read_to_string(&policy).unwrap();

    let deploy = drex(["deploy", at, "--json"]);
    if deploy.code == 0 {
        let file: serde_json::Value =
            serde_json::from_slice(&fs::read(twin.join("policy/deploy.json")).unwrap()).unwrap();
        let card: serde_json::Value = serde_json::from_str(&version).unwrap();
        assert_eq!(file["weights"]["sha256"], card["weights_sha256"]);
        assert_eq!(file["limits"]["force"].as_array().unwrap().len(), 16);
        assert_eq!(file["limits"]["unit"], "mA");
        assert_eq!(file["force_law"]["torque_limits_nm"], serde_json::json!(vec![0.29; 16]));
        assert!(deploy.json()["driven"].is_null());
        assert_eq!((&file["limits"]["motor"], &file["limits"]["motor_assumed"]), (&"XC330-M288".into(), &true.into()));
        assert_eq!(file["limits"]["cap"], 200.0);
        #[cfg(unix)]
        deploys_by_the_motors_that_it_finds(at, &twin, &file);
        let log = twin.join("grasp.csv");
        let emulated = drex([
            "deploy",
            at,
            "--hand",
            "leap",
            "--emulate",
            "--hold",
            "1",
            "--log",
            log.to_str().unwrap(),
            "--json",
        ]);
        let driven = emulated.json()["driven"].clone();
        assert!(driven["missed"] == false && driven["lost"] == false, "{driven}");
        // What presses, presses as hard as its limit.
        let contacts = driven["contacts"].as_array().unwrap();
        assert!(contacts.len() >= 2, "{driven}");
        for c in contacts {
            let (held, limit) = (c["held_effort"].as_f64().unwrap(), c["effort_limit"].as_f64().unwrap());
            assert!((held - limit).abs() < 2.0, "{c}");
        }
        assert!(log.is_file() && !log.with_extension("csv.part").exists());
    } else {
        // Six demonstrations may teach no grasp that holds: then it says so and writes nothing.
        deploy.fails_with(&["no grasp to deploy"]);
        assert!(!twin.join("policy/deploy.json").exists());
    }
    let number = version.split("\"version\": ").nth(1).unwrap().split(',').next().unwrap().to_owned();
    edit(&policy, &format!("\"version\": {number}"), "\"version\": 99");
    drex(["grasp", at]).fails_with(&["version is 99"]);
}

/// A hand with XL330 motors: their own torque-current model and cap, and what speaks against it stops it.
#[cfg(unix)]
fn deploys_by_the_motors_that_it_finds(at: &str, twin: &std::path::Path, full: &serde_json::Value) {
    use drex_hw::emulator::leap::LeapEmulator;
    use drex_hw::emulator::pty::PtyServer;
    use drex_hw::leap::table::{self, MotorModel};

    let hand = LeapEmulator::with_model(MotorModel::Xl330M288).in_real_time();
    hand.set(6, table::HOMING_OFFSET, 1000);
    let link = twin.join("leap");
    let _server = PtyServer::serve(hand.clone(), Some(&link)).unwrap();
    let port = ["deploy", at, "--port", link.to_str().unwrap(), "--hold", "0.1", "--json", PATIENT[0], PATIENT[1]];
    drex(port).fails_with(&["homing-offset", "--allow"]);
    drex(port.into_iter().chain(["--allow", "homing-offset", "--cap", "1740"])).fails_with(&["stalls", "1470 mA"]);
    // Nothing is in its way: whether it then misses is no matter here, the file is.
    drex(port.into_iter().chain(["--allow", "homing-offset", "--cap", "200"]));
    let lite: serde_json::Value = serde_json::from_slice(&fs::read(twin.join("policy/deploy.json")).unwrap()).unwrap();
    assert_eq!((&lite["limits"]["motor"], &lite["limits"]["motor_assumed"]), (&"XL330-M288".into(), &false.into()));
    let most = |f: &serde_json::Value| {
        let force = f["limits"]["force"].as_array().unwrap();
        force.iter().map(|v| v.as_f64().unwrap()).fold(0.0, f64::max)
    };
    // The same torque takes more current of a weaker motor, as far as the cap lets it.
    assert!(most(&lite) > most(full) || most(full) == 200.0, "{} and {} mA", most(&lite), most(full));
    let spread = lite["limits"]["published_nm"].as_array().unwrap();
    assert!(spread[0].as_f64().unwrap() < spread[1].as_f64().unwrap(), "{spread:?}");
    assert_eq!(hand.under_torque(), 0);
}
