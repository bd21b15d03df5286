"""Sentences of a fingerprint's verdict in German, by the pattern of the English ones."""

from __future__ import annotations

from shipfp_rs.report.german_words import ELEMENTS

PHRASES: tuple[tuple[str, str], ...] = (
    (
        r"^Not usable, because the data determine no parameter\.",
        "Nicht brauchbar, weil die Daten keinen Parameter bestimmen.",
    ),
    (
        r"^Not usable, because the search ended where (.+) can't go further; the ship is another one than the model\.",
        r"Nicht brauchbar, denn die Suche endete, wo \1 nicht weiter kann; das Schiff ist ein anderes als das Modell.",
    ),
    (
        r"^Usable for simulation and comparison, but its intervals hold for the model, not for the drive train: they agree only "
        r"if the channels are wrong by more than a calibration leaves open\.",
        r"Brauchbar für Simulation und Vergleich, aber die Bereiche gelten für das Modell, nicht für den Antriebsstrang: Sie "
        r"stimmen nur überein, wenn die Kanäle um mehr falsch sind, als eine Kalibrierung offen lässt.",
    ),
    (
        r"^Usable for simulation and comparison, but its intervals are too narrow: the rate of the fuel rack is limited, and the "
        r"deviance of such a ship is not smooth\.",
        r"Brauchbar für Simulation und Vergleich, aber die Bereiche sind zu eng: Die Geschwindigkeit der Füllungsstange ist "
        r"begrenzt, und die Abweichung eines solchen Schiffs ist nicht glatt.",
    ),
    (
        r"^Not usable, because the model misses (\S+) % of the response to the set point\.",
        r"Nicht brauchbar, weil dem Modell \1 % der Antwort auf den Sollwert fehlen.",
    ),
    (
        r"^Not usable, because the search did not end in a minimum; no figure is an estimate\.",
        "Nicht brauchbar, weil die Suche in keinem Minimum endete; keine Zahl ist ein Schätzwert.",
    ),
    (
        r"^Not usable, because the model explains nothing of (.+)\.",
        r"Nicht brauchbar, weil das Modell nichts erklärt von \1.",
    ),
    (
        r"^Usable for simulation and comparison, but the data do not determine (.+), and determine (.+) only roughly: other "
        r"values fit as well\.",
        r"Brauchbar für Simulation und Vergleich, aber die Daten bestimmen \1 nicht und \2 nur grob: Andere Werte passen ebenso gut.",
    ),
    (
        r"^Usable for simulation and comparison, but the data do not determine (.+): other values fit as well\.",
        r"Brauchbar für Simulation und Vergleich, aber die Daten bestimmen \1 nicht: Andere Werte passen ebenso gut.",
    ),
    (
        r"^Usable for simulation and comparison, but its intervals hold for the model, not for the drive train: the model "
        r"misses (\S+) % of the response to the set point\.",
        r"Brauchbar für Simulation und Vergleich, aber die Bereiche gelten für das Modell, nicht für den Antriebsstrang: "
        r"Dem Modell fehlen \1 % der Antwort auf den Sollwert.",
    ),
    (
        r"^Usable for simulation and comparison, but the model misses (\S+) % of the response to the set point\.",
        r"Brauchbar für Simulation und Vergleich, aber dem Modell fehlen \1 % der Antwort auf den Sollwert.",
    ),
    (
        r"^Usable for simulation, control tuning and comparison: the data determine every parameter, (.+) only roughly\.",
        r"Brauchbar für Simulation, Reglereinstellung und Vergleich: Die Daten bestimmen jeden Parameter, \1 aber nur grob.",
    ),
    (
        r"^Usable for simulation, control tuning and comparison: the data determine every parameter\.",
        "Brauchbar für Simulation, Reglereinstellung und Vergleich: Die Daten bestimmen jeden Parameter.",
    ),
    (
        r"^Set point and speed lie apart at the operating point of (.+), (\S+) and (\S+) rpm: a governor with an integral part "
        r"leaves no difference; look at the set point's calibration\.",
        r"Sollwert und Drehzahl liegen im Betriebspunkt von \1 auseinander, \2 und \3 U/min: Ein Regler mit I-Anteil lässt "
        r"keinen Unterschied; die Kalibrierung des Sollwerts prüfen.",
    ),
    (
        r"^The command is taken for the drive's torque \(v = 1, g = 0\), since no torque was measured: of another command tau_n "
        r"and p are told over v only, p as p - g\.",
        "Der Stellbefehl gilt als Moment des Antriebs (v = 1, g = 0), da kein Drehmoment gemessen wurde: Bei einem anderen "
        "Stellbefehl sind tau_n und p nur bezogen auf v bekannt, p als p - g.",
    ),
    (
        r"^The torque (\S+) is (\S+) Nm at (\S+) rpm, where the vessel's file makes (\S+) Nm: look at its scale; inertias "
        r"and gains in SI units are wrong by the same factor\.",
        r"Das Drehmoment \1 ist \2 Nm bei \3 U/min, die Schiffsdatei ergibt \4 Nm: Die Skalierung prüfen; Trägheiten und "
        r"Verstärkungen in SI-Einheiten sind um denselben Faktor falsch.",
    ),
    (r"^Known only together: ", "Nur gemeinsam bekannt: "),
    (r"^Known: ", "Bekannt: "),
    (r"^Known together: ", "Gemeinsam bekannt: "),
    (r"^Undecided: ", "Offen: "),
    (
        r"^T_d holds half the sampling period of the governor, if it samples\.",
        "T_d enthält die halbe Abtastzeit des Reglers, falls er abtastet.",
    ),
    (
        r"the speed tells only ratios to tau_n; measure a torque or give the inertia",
        "die Drehzahl bestimmt nur Verhältnisse zu tau_n; ein Drehmoment messen oder die Trägheit angeben",
    ),
    (r"the data allow everything between (\S+) and (\S+)", r"die Daten erlauben alles zwischen \1 und \2"),
    (r"^According to this model: ", "Nach diesem Modell: "),
    (r"^Acting elements: ", "Wirkende Elemente: "),
    (r"^Not found to act: ", "Keine Wirkung gefunden: "),
    (r"^Not identifiable from these data: ", "Aus diesen Daten nicht bestimmbar: "),
    (
        r"^Undecided, with and without it the model fits as well: (.+); the intervals hold for both\.",
        r"Unentschieden, mit und ohne passt das Modell gleich gut: \1; die Bereiche gelten für beide.",
    ),
    (
        r"^The residuals show that something small is missing \((.+)\); every interval is widened by what that can do\.",
        r"Die Residuen zeigen, dass etwas Kleines fehlt (\1); jeder Bereich ist um das erweitert, was das anrichten kann.",
    ),
    (
        r"^The residuals show that something is missing \((.+)\); every interval is widened by what that can do\.",
        r"Die Residuen zeigen, dass etwas fehlt (\1); jeder Bereich ist um das erweitert, was das anrichten kann.",
    ),
    (
        r"^The data distinguish (\d+) of (\d+) free parameters; the response stays the same along: ",
        r"Die Daten unterscheiden \1 von \2 freien Parametern; die Antwort bleibt gleich entlang: ",
    ),
    (
        r"^Any of these, known from elsewhere \(torsional calculation, factory test\), would settle the rest: ",
        "Jedes davon, aus anderer Quelle bekannt (Drehschwingungsrechnung, Prüfstand), würde den Rest klären: ",
    ),
    (
        r"^The noise is not what was assumed: whitened residuals are still correlated in (.+), so the intervals may be too narrow\.",
        r"Das Rauschen ist nicht wie angenommen: Geweißte Residuen hängen noch zusammen in \1; die Bereiche sind vielleicht zu schmal.",
    ),
    (
        r"^The residuals contradict the structure (.+): the set point still explains some of (.+)\. Dynamics are missing, a dead "
        r"time for instance; the intervals hold for the structure, not for the drive train\.",
        r"Die Residuen widersprechen der Struktur \1: Der Sollwert erklärt noch einen Teil von \2. Es fehlt Dynamik, etwa eine "
        r"Totzeit; die Bereiche gelten für die Struktur, nicht für den Antriebsstrang.",
    ),
    (r"it explains (\S+) % of what was left", r"er erklärt \1 % des Rests"),
    (
        r"^The structure (.+) explains the data poorly \((.+)\): its intervals hold for the structure, not for the drive train\.",
        r"Die Struktur \1 erklärt die Daten schlecht (\2): Ihre Bereiche gelten für die Struktur, nicht für den Antriebsstrang.",
    ),
    (r"\bfit of (\w+)", r"Anpassung von \1"),
    (
        r"^v and g are left out: (.+) are those of the full structure times p / \(p - g\)\.",
        r"v und g sind ausgelassen: \1 sind die der vollen Struktur mal p / (p - g).",
    ),
    (
        r"^The search did not end in a minimum, so take no figure for an estimate: ",
        "Die Suche endete in keinem Minimum, keine Zahl ist ein Schätzwert: ",
    ),
    (
        r"^On a bound, so no estimate but a sign that the structure or the bounds do not suit the data: (.+)\. The other intervals "
        r"hold only if they are there\.",
        r"Auf einer Grenze, also kein Schätzwert, sondern ein Zeichen, dass Struktur oder Grenzen nicht zu den Daten passen: \1. Die "
        r"übrigen Bereiche gelten nur, wenn sie dort sind.",
    ),
    (
        r"^On a bound that the data do not contradict, known from one side: ",
        "Auf einer Grenze, der die Daten nicht widersprechen, von einer Seite bekannt: ",
    ),
    (r"only known together with ", "nur bekannt gemeinsam mit "),
    (r"changes along what the data leave open: ", "ändert sich entlang dessen, was die Daten offen lassen: "),
    (
        r"the data allow everything between its bounds (\S+) and (\S+)",
        r"die Daten erlauben alles zwischen den Grenzen \1 und \2",
    ),
    (r"too few samples for an uncertainty", "zu wenige Messwerte für eine Unsicherheit"),
    (
        r"not determined by a structure that fits as well",
        "nicht bestimmt von einer Struktur, die ebenso gut passt",
    ),
    (
        r"on its lower bound (\S+); the data allow up to ",
        r"auf seiner unteren Grenze \1; die Daten erlauben bis ",
    ),
    (
        r"on its upper bound (\S+); the data allow down to ",
        r"auf seiner oberen Grenze \1; die Daten erlauben hinab bis ",
    ),
    (r"pressed against its lower bound ", "an seine untere Grenze gedrückt, "),
    (r"pressed against its upper bound ", "an seine obere Grenze gedrückt, "),
    (
        r"its standard deviation (\S+) says less than its bounds (\S+) to ",
        r"seine Standardabweichung \1 sagt weniger als seine Grenzen \2 bis ",
    ),
    (r"the data do not depend on it", "die Daten hängen nicht davon ab"),
    (r"the data only say that it is below ", "die Daten sagen nur: unter "),
    (r"the data only say that it is above ", "die Daten sagen nur: über "),
    (
        r"the fit goes beyond (\S+), which no drive train has",
        r"die Anpassung geht über \1 hinaus, was kein Antriebsstrang hat",
    ),
    *((rf"\b{english}\b", german) for english, german in ELEMENTS.items()),
    (r"(?<=\w) and (?=\w+( nicht: Andere| nicht und| nur grob| aber nur grob))", " und "),
    (r" and (?=the (speed|torque|fuel rack)\b)", " und "),
    (r" % of the speed\b", " % der Drehzahl"),
    (r" % of the torque\b", " % des Drehmoments"),
    (r" % of the fuel rack\b", " % der Füllung"),
    (r"\bthe (?=speed\b|fuel rack\b)", "der "),
    (r"\bthe (?=torque\b)", "dem "),
    (r"\bspeed\b", "Drehzahl"),
    (r"\btorque\b", "Drehmoment"),
    (r"\bfuel rack\b", "Füllung"),
    (r"(?<=\d) to (?=-?\d)", " bis "),
    (r" below (?=\d)", " unter "),
    (r" above (?=\d)", " über "),
    (r", (\w+) or (\w+)\b", r", \1 oder \2"),
)
"""Patterns of a fingerprint's sentences and what they become, one after the other."""
